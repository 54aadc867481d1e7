"""Bytes of the wire, written from SPEC.md alone: packets (section 1), frames (4), messages (5), the configuration (6).

Shares no code with the project, so that the project's own codec is never what it is compared with.

    payload, CRC-32C of it (little-endian)  ->  COBS  ->  one 0x00
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

POLYNOMIAL: Final = 0x1EDC6F41
"""Castagnoli's, highest power first; the check is made lowest bit first."""

HELLO_REQUEST, START, STOP, SET_MODE, TIME_REQUEST = 0x01, 0x02, 0x03, 0x04, 0x05
READ, BEGIN, WRITE, VERIFY, COMMIT, CONFIRM, ROLLBACK, ABORT, RESTART = range(0x10, 0x19)
HELLO, ACK, FRAME, CONFIG_DATA, EVENT, TIME = 0x80, 0x81, 0x82, 0x83, 0x84, 0x85

(
    OK,
    UNKNOWN_TYPE,
    BAD_LENGTH,
    BAD_VALUE,
    BAD_VERSION,
    BUSY,
    NO_SESSION,
    WRONG_HARDWARE,
    DOWNGRADE,
    BAD_FORMAT,
    TOO_LARGE,
    BAD_OFFSET,
    INCOMPLETE,
    DIGEST_MISMATCH,
    INVALID_CONFIGURATION,
    STORAGE_FAILED,
    NO_PREVIOUS,
    NOT_CONFIRMED,
    WRONG_GENERATION,
    STREAMING,
    FRONT_END_FAILED,
    RATE_TOO_HIGH,
) = range(22)

RESTARTING, CONFIGURATION_CHANGED, ROLLED_BACK, OVERRUN, FRONT_END_LOST = 1, 2, 3, 4, 5

LARGEST: Final = 1024
"""Bytes of the largest payload."""
MAGIC: Final = b"EITS"
BLOB_MAGIC: Final = b"EITC"

LAYOUTS: Final = {
    HELLO_REQUEST: "<BB4sBB",
    START: "<BBI",
    STOP: "<BB",
    SET_MODE: "<BBB",
    TIME_REQUEST: "<BB",
    READ: "<BBBHB",
    BEGIN: "<BBIHIIIBB16s",
    WRITE: "<BBIH",
    VERIFY: "<BBI",
    COMMIT: "<BBII",
    CONFIRM: "<BBII",
    ROLLBACK: "<BBII",
    ABORT: "<BBI",
    RESTART: "<BBI",
    HELLO: "<BB4sBB8s8s3sBI16sII16sIBBHHHIId",
    ACK: "<BBBBI",
    FRAME: "<BBBBIIIHH",
    CONFIG_DATA: "<BBBIHH",
    EVENT: "<BBII",
    TIME: "<BBI",
}
"""Of the fields before a tail; an id, a text and a version are bytes."""

TAILS: Final = {WRITE: 32, CONFIG_DATA: 32, FRAME: LARGEST}
"""Largest tail of those that have one."""

CONFIGURATION: Final = "<4sBBHII16sIIIIHHHHHBBI"


def _table() -> list[int]:
    reflected = int(f"{POLYNOMIAL:032b}"[::-1], 2)
    table = []
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = value >> 1 ^ (reflected if value & 1 else 0)
        table.append(value)
    return table


_TABLE: Final = _table()


def crc32c(data: bytes) -> int:
    """Return the check of bytes."""
    value = 0xFFFFFFFF
    for byte in data:
        value = value >> 8 ^ _TABLE[(value ^ byte) & 0xFF]
    return value ^ 0xFFFFFFFF


def stuff(data: bytes) -> bytes:
    """Return bytes without a 0x00 in them that ``unstuff`` turns back."""
    blocks = []
    runs = data.split(b"\0")
    for number, run in enumerate(runs):
        at = 0
        while len(run) - at >= 254:
            blocks.append(b"\xff" + run[at : at + 254])
            at += 254
        if number < len(runs) - 1 or at < len(run) or not run:  # a full block at the very end takes nothing behind it
            blocks.append(bytes((len(run) - at + 1,)) + run[at:])
    return b"".join(blocks)


def unstuff(data: bytes) -> bytes:
    """Return what was stuffed; raise ValueError if it was not."""
    out = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        run = data[at + 1 : at + code]
        if code == 0 or 0 in run or len(run) != code - 1:
            raise ValueError("not stuffed")
        out += run
        at += code
        if code < 255 and at < len(data):
            out.append(0)
    return bytes(out)


def packet(payload: bytes) -> bytes:
    """Return a payload as it goes on the line."""
    return stuff(payload + struct.pack("<I", crc32c(payload))) + b"\0"


def unpacket(data: bytes) -> bytes:
    """Return the payload of what stood before a 0x00; raise ValueError if it is damaged."""
    held = unstuff(data)
    if not 5 <= len(held) <= LARGEST + 4 or struct.unpack("<I", held[-4:])[0] != crc32c(held[:-4]):
        raise ValueError("damaged")
    return held[:-4]


LONGEST: Final = LARGEST + 4 + 1 + (LARGEST + 4) // 254
"""Bytes of the longest packet, without its 0x00."""


class Collector:
    """Collects bytes until 0x00 and gives the payloads of intact packets; counts the others in ``damaged``."""

    def __init__(self) -> None:
        self._held = bytearray()
        self.damaged = 0

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Take what was read, and give whatever payloads it completes."""
        *whole, rest = data.split(b"\0")
        for piece in whole:
            found = bytes(self._held) + piece
            self._held.clear()
            if found:
                try:
                    yield unpacket(found)
                except ValueError:
                    self.damaged += 1
        if len(self._held) <= LONGEST:
            self._held += rest[: LONGEST + 1]


def pack(kind: int, *fields: object, tail: bytes = b"") -> bytes:
    """Return a message's payload; fields are those after the type."""
    return struct.pack(LAYOUTS[kind], kind, *fields) + tail


def unpack(payload: bytes) -> tuple[object, ...]:
    """Return a message's fields after the type, and a tail last if its kind has one; ValueError for a wrong length."""
    layout = LAYOUTS[payload[0]]
    size = struct.calcsize(layout)
    room = TAILS.get(payload[0], 0)
    if not size <= len(payload) <= size + room:
        raise ValueError(f"{len(payload)} bytes of 0x{payload[0]:02x}, expected {size} to {size + room}")
    fields = struct.unpack(layout, payload[:size])[1:]
    return (*fields, payload[size:]) if payload[0] in TAILS else fields


@dataclass
class Frame:
    """One scan, before it is packed."""

    sequence: int
    device_us: int
    counts: Sequence[int]
    drives: int
    generation: int
    flags: int = 0
    sample_bytes: int = 3
    dropped: int = 0
    saturated: Sequence[int] = ()

    def payload(self) -> bytes:
        """Return it as a FRAME."""
        rows = len(self.counts)
        samples = b"".join(int(count).to_bytes(self.sample_bytes, "little", signed=True) for count in self.counts)
        bits = bytearray((rows + 7) // 8)
        for row in self.saturated:
            bits[row // 8] |= 1 << row % 8
        head = (self.flags, self.sample_bytes, rows, self.generation, self.sequence % 2**32, self.device_us % 2**32)
        return pack(FRAME, *head, self.drives, self.dropped % 2**16, tail=samples + bytes(bits))


def frame_of(payload: bytes) -> Frame:
    """Return the scan that a FRAME holds; raise ValueError if its length does not fit its rows."""
    flags, sample_bytes, rows, generation, sequence, device_us, drives, dropped, tail = unpack(payload)
    assert isinstance(tail, bytes)
    assert isinstance(rows, int)
    assert isinstance(sample_bytes, int)
    if sample_bytes not in (2, 3, 4) or len(tail) != rows * sample_bytes + (rows + 7) // 8:
        raise ValueError("the samples do not fit")
    counts = [
        int.from_bytes(tail[row * sample_bytes : (row + 1) * sample_bytes], "little", signed=True)
        for row in range(rows)
    ]
    bits = tail[rows * sample_bytes :]
    saturated = [row for row in range(rows) if bits[row // 8] >> row % 8 & 1]
    return Frame(
        *(sequence, device_us, counts, drives, generation, flags, sample_bytes, dropped, saturated)  # type: ignore[arg-type]
    )
