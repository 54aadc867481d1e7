"""A configuration: what the device scans, how, and how often; as a value and as the blob that the device stores.

::

    0      4       5     6     8            12        16    32            36        40             44
    magic  format  rows  size  hardware_id  revision  name  frequency_Hz  rate_mHz  idle_rate_mHz  current_uA
    EITC   u8      u8    u16   u32          u32       16    u32           u32       u32            u32

    48         50        52    54      56           58            59        60
    settle_us  averages  gain  drives  idle_drives  sample_bytes  flags  crc32c of bytes 0 to 59
    u16        u16       u16   u16     u16          u8            u8     u32

A configuration may state which skin it is for. Flag 1 then says that the second half of ``name`` is the skin's digest;
such a name has at most 8 characters. Everything else stays where it was.

The digest of a configuration is that last word: it names the configuration in HELLO and in files that depend on it.
``revision`` belongs to the author: a device refuses to replace a configuration by a lower revision of the same name.
"""

import re
import struct
from dataclasses import dataclass, fields
from typing import Final, Self

from eitskin_proto.errors import ProtocolError
from eitskin_proto.files.plain import quoted
from eitskin_proto.sensor.table import N_FULL_ROWS, N_ROWS
from eitskin_proto.wire import hardware
from eitskin_proto.wire.frames import SAMPLE_BYTES, frame_bytes
from eitskin_proto.wire.framing import crc32c, wire_bytes
from eitskin_proto.wire.scan_rows import ALL_DRIVES, drive_count, row_count

SKIN: Final = re.compile("[0-9a-f]{16}")

BLOB: Final = struct.Struct("<4sBBHII16sIIIIHHHHHBB")
"""The blob without its check."""

BLOB_FIELDS: Final = (
    ("magic", "magic"), ("format", "u8"), ("rows", "u8"), ("size", "u16"), ("hardware_id", "u32"), ("revision", "u32"),
    ("name", "text16"), ("frequency_Hz", "u32"), ("rate_mHz", "u32"), ("idle_rate_mHz", "u32"), ("current_uA", "u32"),
    ("settle_us", "u16"), ("averages", "u16"), ("gain", "u16"), ("drives", "u16"), ("idle_drives", "u16"),
    ("sample_bytes", "u8"), ("flags", "u8"), ("crc", "u32"),
)  # fmt: skip
"""The same for the generated tables."""

BLOB_BYTES: Final = BLOB.size + 4
"""64."""

BLOB_MAGIC: Final = b"EITC"
FORMAT: Final = 1

HAS_SKIN: Final = 1
"""Flag: the second half of the name is the digest of a skin."""

SKIN_AT: Final = 24
"""Where that is in the blob."""

SHORT_NAME: Final = 8
"""Characters of a name beside which a skin is stated."""

LINE_SHARE: Final = 0.95
"""Part of a line that frames may fill; the rest is for answers and events."""


def published_name(field: str) -> str:
    """Return what the JSON of 'eitskin flash' calls a field: rates are in millihertz there in full."""
    return field.replace("rate_mHz", "rate_millihertz")


@dataclass(frozen=True, slots=True)
class Configuration:
    """What a device scans. ``check`` says whether electronics and line can do it."""

    name: str
    """At most 16 ASCII characters; 8 where a skin is stated."""
    revision: int
    hardware_id: int
    frequency_hz: int
    """Of the drive current."""
    current_ua: int
    """Amplitude of the drive current."""
    settle_us: int
    """Wait after each change of drive."""
    averages: int
    """Whole periods averaged a drive."""
    gain: int
    """Linear gain of the amplifier."""
    sample_bytes: int
    """2, 3 or 4."""
    rows: int
    """104 for the table, 208 for the full table; fewer come out if ``drives`` leaves some out."""
    drives: int
    """Bit k: drive k is scanned."""
    rate_mHz: int
    idle_drives: int = 0
    """The same for the idle mode; 0 if there is none."""
    idle_rate_mHz: int = 0
    skin: str = ""
    """Digest of the skin's description, 16 hex digits; "" if it is not stated."""

    def __post_init__(self) -> None:
        if self.skin and (not SKIN.fullmatch(self.skin) or not int(self.skin, 16)):
            raise ValueError(f"skin is {quoted(self.skin)}, expected a digest of 16 hex digits that are not all 0")
        if self.skin and len(self.name) > SHORT_NAME:
            raise ValueError(f"name is {quoted(self.name)}, expected at most {SHORT_NAME} characters beside a skin")
        if not 1 <= len(self.name) <= 16 or not self.name.isascii() or not self.name.isprintable():
            raise ValueError(f"name is {quoted(self.name)}, expected 1 to 16 printable ASCII characters")
        if self.rows not in (N_ROWS, N_FULL_ROWS):
            raise ValueError(f"rows is {self.rows}, expected {N_ROWS} (the table) or {N_FULL_ROWS} (the full table)")
        if self.sample_bytes not in SAMPLE_BYTES:
            raise ValueError(f"samples have {8 * self.sample_bytes} bits, expected 16, 24 or 32")
        for field, low, high in (
            ("revision", 0, 0xFFFFFFFF), ("hardware_id", 0, 0xFFFFFFFF), ("frequency_hz", 1, 0xFFFFFFFF),
            ("current_ua", 1, 0xFFFFFFFF), ("settle_us", 0, 0xFFFF), ("averages", 1, 0xFFFF), ("gain", 1, 0xFFFF),
            ("drives", 1, ALL_DRIVES), ("rate_mHz", 1, 0xFFFFFFFF), ("idle_drives", 0, ALL_DRIVES),
            ("idle_rate_mHz", 0, 0xFFFFFFFF),
        ):  # fmt: skip
            value = getattr(self, field)
            if not low <= value <= high:
                raise ValueError(f"{field} is {value}, expected {low} to {high}")
        if row_count(self.full, self.drives) == 0:
            raise ValueError(f"drives 0x{self.drives:04x} have no row in the table of {self.rows}")
        if bool(self.idle_drives) != bool(self.idle_rate_mHz):
            raise ValueError("the idle mode needs both drives and a rate, or neither")
        if self.idle_drives and row_count(self.full, self.idle_drives) == 0:
            raise ValueError(f"idle drives 0x{self.idle_drives:04x} have no row in the table of {self.rows}")

    @property
    def full(self) -> bool:
        """Whether the rows come from the full table of 208."""
        return self.rows == N_FULL_ROWS

    @property
    def rate_hz(self) -> float:
        """Frames a second in the active mode."""
        return self.rate_mHz / 1000

    @property
    def frame_rows(self) -> int:
        """Rows of a frame in the active mode."""
        return row_count(self.full, self.drives)

    @property
    def digest(self) -> int:
        """CRC-32C that names this configuration."""
        return int.from_bytes(self.to_blob()[BLOB.size :], "little")

    def to_blob(self) -> bytes:
        """Return the 64 bytes that the device stores."""
        name = self.name.encode("ascii").ljust(SHORT_NAME, b"\0") + bytes.fromhex(self.skin)
        body = BLOB.pack(
            BLOB_MAGIC, FORMAT, self.rows, BLOB_BYTES, self.hardware_id, self.revision, name,
            self.frequency_hz, self.rate_mHz, self.idle_rate_mHz, self.current_ua, self.settle_us,
            self.averages, self.gain, self.drives, self.idle_drives, self.sample_bytes, HAS_SKIN if self.skin else 0,
        )  # fmt: skip
        return body + crc32c(body).to_bytes(4, "little")

    @classmethod
    def from_blob(cls, blob: bytes) -> Self:
        """Return the configuration of a blob.

        Raises:
            ProtocolError: Wrong length, magic, format, check or value; each named.
        """
        if len(blob) < 5 or blob[:4] != BLOB_MAGIC:
            raise ProtocolError(f"configuration starts with {blob[:4]!r}, expected {BLOB_MAGIC!r}")
        if blob[4] != FORMAT:
            raise ProtocolError(f"configuration has format {blob[4]}, this release reads format {FORMAT}")
        if len(blob) != BLOB_BYTES:
            raise ProtocolError(f"configuration has {len(blob)} bytes, expected {BLOB_BYTES}")
        found, expected = int.from_bytes(blob[BLOB.size :], "little"), crc32c(blob[: BLOB.size])
        if found != expected:
            raise ProtocolError(f"configuration is damaged: its checksum is {found:08x}, expected {expected:08x}")
        (_, _, rows, size, hardware_id, revision, raw_name, frequency, rate, idle_rate, current, settle, averages, gain,
         drives, idle_drives, sample_bytes, flags) = BLOB.unpack_from(blob)  # fmt: skip
        if size != BLOB_BYTES or flags not in (0, HAS_SKIN):
            raise ProtocolError(f"configuration has size {size} and flags {flags}, expected {BLOB_BYTES} and 0 or 1")
        skin = raw_name[SHORT_NAME:].hex() if flags else ""
        name = (raw_name[:SHORT_NAME] if flags else raw_name).rstrip(b"\0")
        try:
            return cls(
                name=name.decode("ascii"), revision=revision, hardware_id=hardware_id, frequency_hz=frequency,
                current_ua=current, settle_us=settle, averages=averages, gain=gain, sample_bytes=sample_bytes,
                rows=rows, drives=drives, rate_mHz=rate, idle_drives=idle_drives,
                idle_rate_mHz=idle_rate, skin=skin,
            )  # fmt: skip
        except ValueError as error:  # UnicodeDecodeError is one
            raise ProtocolError(f"configuration is intact but impossible: {error}") from error

    def published(self) -> dict[str, object]:
        """Return every field as 'eitskin flash --json' prints it: by the names that were published."""
        return {published_name(field.name): getattr(self, field.name) for field in fields(self)}

    def check(self, line_bytes_per_s: float = 0.0) -> None:
        """Say whether electronics and line can do this.

        Args:
            line_bytes_per_s: What the line carries: a tenth of a UART's baud rate. 0 if it is no limit.

        Raises:
            ValueError: A value is outside what the electronics have, or a rate is too high; the largest that works is
                given.
        """
        can = hardware.hardware_of(self.hardware_id)
        if not can.min_frequency_hz <= self.frequency_hz <= can.max_frequency_hz:
            raise ValueError(
                f"frequency_Hz is {self.frequency_hz}, "
                f"{can.name} drives {can.min_frequency_hz} to {can.max_frequency_hz}"
            )
        if self.current_ua > can.max_current_ua:
            raise ValueError(f"current_uA is {self.current_ua}, {can.name} drives at most {can.max_current_ua}")
        if self.gain not in can.gains:
            raise ValueError(f"gain is {self.gain}, {can.name} has {', '.join(map(str, can.gains))}")
        if self.settle_us < can.min_settle_us:
            raise ValueError(f"settle_us is {self.settle_us}, {can.name} needs at least {can.min_settle_us}")
        self._check_rate("rate_Hz", self.drives, self.rate_mHz, line_bytes_per_s)
        if self.idle_drives:
            self._check_rate("idle rate_Hz", self.idle_drives, self.idle_rate_mHz, line_bytes_per_s)

    def _check_rate(self, what: str, drives: int, rate_mHz: int, line_bytes_per_s: float) -> None:
        front_end = 1e9 / self.scan_us(drives)
        line = largest_line_rate_hz(row_count(self.full, drives), self.sample_bytes, line_bytes_per_s) * 1000
        largest = min(front_end, line)
        if rate_mHz > largest:
            part = "the front end" if front_end <= line else f"a line of {line_bytes_per_s:.0f} bytes/s"
            raise ValueError(
                f"{what} is {rate_mHz / 1000!r}, but {part} reaches at most {int(largest) / 1000!r} "
                f"with {row_count(self.full, drives)} rows of {8 * self.sample_bytes} bits"
            )

    def scan_us(self, drives: int | None = None) -> int:
        """Return how long the front end takes for one scan; periods are rounded up to whole microseconds a drive."""
        can = hardware.hardware_of(self.hardware_id)
        count = drive_count(self.full, self.drives if drives is None else drives)
        return can.scan_overhead_us + count * (self.settle_us + -(-self.averages * 1_000_000 // self.frequency_hz))


def largest_line_rate_hz(rows: int, sample_bytes: int, line_bytes_per_s: float) -> float:
    """Return how many frames a second a line carries; infinity if the line is no limit.

    Args:
        rows: Rows of a frame.
        sample_bytes: 2, 3 or 4.
        line_bytes_per_s: A tenth of a UART's baud rate; 0 for no limit.
    """
    if line_bytes_per_s <= 0.0:
        return float("inf")
    return LINE_SHARE * line_bytes_per_s / wire_bytes(frame_bytes(rows, sample_bytes))
