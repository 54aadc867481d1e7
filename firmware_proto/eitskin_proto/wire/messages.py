"""Every message of the wire as a frozen value that packs itself, and ``unpack``, which checks every byte.

Requests carry a ``tag`` that their answer repeats, so that an answer that comes late or twice is recognised. ::

    host -> device                              device -> host
    HelloRequest                                Hello
    Start, Stop, SetMode                        Ack (code, detail); then Frame, Frame, ...
    TimeRequest                                 Time
    ConfigRead                                  ConfigData, or Ack with an error
    ConfigBegin .. Write .. Verify .. Commit    Ack each
    Restart, then ConfigConfirm                 Ack each, Event
    ConfigRollback, ConfigAbort                 Ack

Unknown types and versions are named in the error. The frame lives in :mod:`eitskin_proto.wire.frames`.
"""

from dataclasses import dataclass
from typing import ClassVar, Final, Self

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
    Mode,
    Slot,
)
from eitskin_proto.wire.frames import Frame
from eitskin_proto.wire.layout import Layout, Packed


@dataclass(frozen=True, slots=True)
class Hello(Packed):
    """The device's identity, what it measures, and how to read its frames."""

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
    """Time since boot; smaller than expected after an unnoticed reset."""
    line_bytes_per_s: int = 0
    """Capacity of the device's own line; 0 if unknown."""
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
    """The code's detail: an offset, a digest, a generation, a time in ms, a bound."""
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


CHUNK_BYTES: Final = 32
"""Most configuration bytes in one CONFIG_WRITE or CONFIG_DATA."""


@dataclass(frozen=True, slots=True)
class ConfigRead(Packed):
    """Asks for a piece of a stored configuration."""

    LAYOUT: ClassVar = Layout(
        MessageType.CONFIG_READ, (("tag", "u8"), ("slot", "u8"), ("offset", "u16"), ("length", "u8"))
    )
    tag: int = 0
    slot: int = Slot.ACTIVE
    offset: int = 0
    length: int = CHUNK_BYTES


@dataclass(frozen=True, slots=True)
class ConfigBegin(Packed):
    """Takes the lock with a token, announces the configuration, and erases the inactive slot."""

    LAYOUT: ClassVar = Layout(
        MessageType.CONFIG_BEGIN,
        (
            ("tag", "u8"), ("token", "u32"), ("size", "u16"), ("digest", "u32"), ("hardware_id", "u32"),
            ("revision", "u32"), ("format", "u8"), ("allow_downgrade", "u8"), ("name", "text16"),
        ),
    )  # fmt: skip
    token: int
    size: int
    digest: int
    hardware_id: int
    revision: int
    name: str
    format: int
    allow_downgrade: int = 0
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigWrite(Packed):
    """Writes the next piece into the inactive slot."""

    LAYOUT: ClassVar = Layout(
        MessageType.CONFIG_WRITE, (("tag", "u8"), ("token", "u32"), ("offset", "u16"), ("data", "tail")), CHUNK_BYTES
    )
    token: int
    offset: int
    data: bytes
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigVerify(Packed):
    """Asks the device to read the inactive slot back; the answer's detail is the digest found there."""

    LAYOUT: ClassVar = Layout(MessageType.CONFIG_VERIFY, (("tag", "u8"), ("token", "u32")))
    token: int
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigCommit(Packed):
    """Makes the inactive slot the one to try at the next boot; the answer's detail is its generation."""

    LAYOUT: ClassVar = Layout(MessageType.CONFIG_COMMIT, (("tag", "u8"), ("token", "u32"), ("digest", "u32")))
    token: int
    digest: int
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigConfirm(Packed):
    """Ends the trial of the running configuration; without it the next boot rolls back."""

    LAYOUT: ClassVar = Layout(MessageType.CONFIG_CONFIRM, (("tag", "u8"), ("generation", "u32"), ("digest", "u32")))
    generation: int
    digest: int
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigRollback(Packed):
    """Revokes the given generation, so that the next boot runs the other slot."""

    LAYOUT: ClassVar = Layout(MessageType.CONFIG_ROLLBACK, (("tag", "u8"), ("token", "u32"), ("generation", "u32")))
    token: int
    generation: int
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigAbort(Packed):
    """Gives the lock back without committing."""

    LAYOUT: ClassVar = Layout(MessageType.CONFIG_ABORT, (("tag", "u8"), ("token", "u32")))
    token: int
    tag: int = 0


@dataclass(frozen=True, slots=True)
class Restart(Packed):
    """Boots the device again, after the answer has left."""

    LAYOUT: ClassVar = Layout(MessageType.RESTART, (("tag", "u8"), ("token", "u32")))
    token: int = 0
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigData(Packed):
    """A piece of a stored configuration."""

    LAYOUT: ClassVar = Layout(
        MessageType.CONFIG_DATA,
        (("tag", "u8"), ("slot", "u8"), ("generation", "u32"), ("offset", "u16"), ("total", "u16"), ("data", "tail")),
        CHUNK_BYTES,
    )
    slot: int
    generation: int
    offset: int
    total: int
    data: bytes
    tag: int = 0


@dataclass(frozen=True, slots=True)
class HelloRequest(Packed):
    """Asks the device for HELLO; the first message of a host."""

    LAYOUT: ClassVar = Layout(
        MessageType.HELLO_REQUEST,
        (("tag", "u8"), ("magic", "magic"), ("protocol_major", "u8"), ("protocol_minor", "u8")),
    )
    tag: int = 0
    protocol_major: int = PROTOCOL_MAJOR
    protocol_minor: int = PROTOCOL_MINOR


@dataclass(frozen=True, slots=True)
class Start(Packed):
    """Starts streaming."""

    LAYOUT: ClassVar = Layout(MessageType.START, (("tag", "u8"), ("frames", "u32")))
    tag: int = 0
    frames: int = 0
    """How many frames to send; 0 for as many as there are until STOP."""


@dataclass(frozen=True, slots=True)
class Stop(Packed):
    """Stops streaming; the sequence number keeps its value."""

    LAYOUT: ClassVar = Layout(MessageType.STOP, (("tag", "u8"),))
    tag: int = 0


@dataclass(frozen=True, slots=True)
class SetMode(Packed):
    """Switches between the whole scan and the idle subset, at once and without touching the stored configuration."""

    LAYOUT: ClassVar = Layout(MessageType.SET_MODE, (("tag", "u8"), ("mode", "u8")))
    tag: int = 0
    mode: int = Mode.ACTIVE


@dataclass(frozen=True, slots=True)
class TimeRequest(Packed):
    """Asks for the device's clock; the round trip bounds the offset between the clocks."""

    LAYOUT: ClassVar = Layout(MessageType.TIME_REQUEST, (("tag", "u8"),))
    tag: int = 0


Request = (
    HelloRequest | Start | Stop | SetMode | TimeRequest | ConfigRead | ConfigBegin | ConfigWrite | ConfigVerify
    | ConfigCommit | ConfigConfirm | ConfigRollback | ConfigAbort | Restart
)  # fmt: skip
"""The messages of a host."""

Message = Request | Hello | Ack | Frame | ConfigData | Event | Time
"""Anything on the wire."""

PLAIN: Final[tuple[type[Packed], ...]] = (
    HelloRequest, Start, Stop, SetMode, TimeRequest, ConfigRead, ConfigBegin, ConfigWrite, ConfigVerify, ConfigCommit,
    ConfigConfirm, ConfigRollback, ConfigAbort, Restart, Hello, Ack, ConfigData, Event, Time,
)  # fmt: skip
"""Every message that a layout describes, in the order of the types; the frame is the only other one."""

_BY_TYPE: Final = {int(kind.LAYOUT.type): kind for kind in PLAIN}


def unpack(payload: bytes) -> Message:
    """Return the message of an intact payload.

    Raises:
        ProtocolError: The type is unknown, or the payload is not exactly that message.
    """
    if not payload:
        raise ProtocolError("an empty payload is not a message; expected a type byte")
    if payload[0] == MessageType.FRAME:
        return Frame.unpack(payload)
    kind = _BY_TYPE.get(payload[0])
    if kind is None:
        raise ProtocolError(
            f"message type 0x{payload[0]:02x} is unknown to protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}; "
            "the other side is newer, or it is not an eitskin device"
        )
    return kind.unpack(payload)  # type: ignore[return-value]
