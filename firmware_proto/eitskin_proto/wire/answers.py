"""What a device sends to a host, apart from frames: who it is, answers to requests, events."""

from dataclasses import dataclass
from typing import ClassVar, Self

from eitskin_proto.errors import MismatchError, ProtocolError
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.wire.codes import (
    CODE_TEXT,
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    Code,
    EventCode,
    HelloFlag,
    MessageType,
)
from eitskin_proto.wire.layout import Layout, Packed


@dataclass(frozen=True, slots=True)
class Hello(Packed):
    """Who the device is, what it measures, and what a host must know to read its frames."""

    LAYOUT: ClassVar = Layout(
        MessageType.HELLO,
        (
            ("tag", "u8"), ("magic", "magic"), ("protocol_major", "u8"), ("protocol_minor", "u8"),
            ("protocol_id", "id"), ("grid_id", "id"), ("firmware_version", "version"), ("flags", "u8"),
            ("hardware_id", "u32"), ("serial_number", "text16"), ("configuration_digest", "u32"),
            ("generation", "u32"), ("configuration_name", "text16"), ("rate_mHz", "u32"), ("rows", "u8"),
            ("sample_bytes", "u8"), ("drives", "u16"), ("idle_drives", "u16"), ("max_payload", "u16"),
            ("uptime_ms", "u32"), ("line_bytes_per_s", "u32"), ("volts_per_count", "f64"),
        ),
    )  # fmt: skip
    firmware_version: tuple[int, int, int]
    hardware_id: int
    """Kind of electronics; see :mod:`eitskin_proto.wire.hardware`."""
    serial_number: str
    """At most 16 ASCII characters; a reference belongs to one serial number."""
    configuration_digest: int
    """CRC-32C of the active configuration's blob."""
    generation: int
    """Counts committed configurations; 0 for the one built into the firmware."""
    configuration_name: str
    rate_mHz: int
    """Frames in 1000 s that the active mode aims at."""
    rows: int
    """Rows of a frame in the active mode."""
    sample_bytes: int
    """2, 3 or 4."""
    volts_per_count: float
    """V; a sample is this often its count."""
    drives: int = 0xFFFF
    idle_drives: int = 0
    flags: int = 0
    """:class:`eitskin_proto.wire.codes.HelloFlag`."""
    uptime_ms: int = 0
    """Time since boot; smaller than it should be after a reset that nobody saw."""
    line_bytes_per_s: int = 0
    """What the device's own line carries; 0 if it does not know."""
    max_payload: int = 64
    """Longest payload that the device accepts."""
    protocol_major: int = PROTOCOL_MAJOR
    protocol_minor: int = PROTOCOL_MINOR
    protocol_id: str = PROTOCOL_ID
    grid_id: str = PAPER.grid_id
    """The paper's, or what the configuration states of its skin: ``grid_id`` or the digest."""
    tag: int = 0

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Return the HELLO of a payload; a later minor version may have appended fields, which are ignored.

        Raises:
            ProtocolError: Not a HELLO, or one of another major version, which is named.
        """
        if len(payload) >= 8 and payload[2:6] == b"EITS" and payload[6] != PROTOCOL_MAJOR:
            raise ProtocolError(
                f"the device speaks protocol {payload[6]}.{payload[7]}, expected {PROTOCOL_MAJOR}.x; "
                "install the eitskin release of the device's firmware, or update the firmware"
            )
        later = len(payload) >= 8 and payload[7] > PROTOCOL_MINOR
        return cls(**cls.LAYOUT.unpack(payload, allow_more=later))

    def check(self) -> None:
        """Refuse a device that measures something else.

        Raises:
            MismatchError: protocol_id differs from this installation's.
        """
        hint = "install the eitskin release that the firmware was built with, or flash the firmware of this release"
        if self.protocol_id != PROTOCOL_ID:
            raise MismatchError("HELLO.protocol_id", found=self.protocol_id, expected=PROTOCOL_ID, hint=hint)

    @property
    def skin_digest(self) -> str:
        """What the configuration states of its skin: ``grid_id`` or the digest; "" if it states none."""
        return "" if self.grid_id == PAPER.grid_id else self.grid_id

    def check_skin(self, skin: Skin) -> None:
        """Refuse a device that is configured for another sheet; one that states none may have any.

        Raises:
            MismatchError: With what was found, expected and the command.
        """
        stated = self.skin_digest
        if not stated or stated in (skin.grid_id, skin.digest, skin.calibrated_from) or _is_shipped(stated, skin):
            return
        hint = (
            "take a bundle of the device's skin (--bundle), or state this sheet in the device's configuration: "
            f"skin = \"{skin.grid_id}\", and 'eitskin flash write'"
        )
        raise MismatchError("the device's skin", found=stated, expected=f"{skin.grid_id} ({skin.name})", hint=hint)

    @property
    def full(self) -> bool:
        """Whether the frames carry rows of the full table."""
        return bool(self.flags & HelloFlag.FULL)


@dataclass(frozen=True, slots=True)
class Ack(Packed):
    """The answer to a request that has no answer of its own."""

    LAYOUT: ClassVar = Layout(MessageType.ACK, (("tag", "u8"), ("request", "u8"), ("code", "u8"), ("detail", "u32")))
    request: int
    """Type byte of the request."""
    code: int = Code.OK
    detail: int = 0
    """What the code needs to say: an offset, a digest, a generation, a time in ms, a bound."""
    tag: int = 0

    @property
    def text(self) -> str:
        """A line for people."""
        try:
            return f"{Code(self.code).name}: {CODE_TEXT[Code(self.code)]}"
        except ValueError:
            return f"code {self.code}, which this host does not know; its release is older than the firmware"


@dataclass(frozen=True, slots=True)
class Event(Packed):
    """Something that happened without a request."""

    LAYOUT: ClassVar = Layout(MessageType.EVENT, (("code", "u8"), ("device_us", "u32"), ("detail", "u32")))
    code: int
    device_us: int = 0
    detail: int = 0

    @property
    def text(self) -> str:
        """The event's name, for people."""
        try:
            return EventCode(self.code).name
        except ValueError:
            return f"event {self.code}"


@dataclass(frozen=True, slots=True)
class Time(Packed):
    """The device's clock at the moment the answer was made."""

    LAYOUT: ClassVar = Layout(MessageType.TIME, (("tag", "u8"), ("device_us", "u32")))
    device_us: int
    tag: int = 0


def _is_shipped(digest: str, skin: Skin) -> bool:
    """Return whether a digest is that of a shipped description of the same sheet."""
    from eitskin_proto.skin.toml import NAMED, named  # noqa: PLC0415 -- few devices state another digest

    return any(one.digest == digest and one.grid_id == skin.grid_id for one in map(named, NAMED))
