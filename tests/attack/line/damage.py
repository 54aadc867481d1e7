"""What noise, a loose plug, a wrong rate or a newer firmware put on the line: damaged packets, and foreign ones."""

import random
import struct
from collections.abc import Callable
from typing import Final

import google_crc32c
from cobs import cobs

LARGEST: Final = 1024
"""Bytes of the largest payload."""


def packet(payload: bytes, flip: int = 0) -> bytes:
    """Return a payload as it goes on the line; its check is wrong in the bits of ``flip``."""
    check = struct.pack("<I", google_crc32c.value(payload) ^ flip)
    return bytes(cobs.encode(payload + check)) + b"\0"


class Reader:
    """Reads a line as a host must, without the project's code: the judge of what was sent whole."""

    def __init__(self) -> None:
        self._held = b""
        self.damaged = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the payloads that bytes complete."""
        *whole, self._held = (self._held + data).split(b"\0")
        self._held = self._held[: 2 * LARGEST]
        found = []
        for piece in filter(None, whole):
            try:
                held = cobs.decode(piece)
            except cobs.DecodeError:
                held = b""
            if 5 <= len(held) <= LARGEST + 4 and held[-4:] == struct.pack("<I", google_crc32c.value(held[:-4])):
                found.append(bytes(held[:-4]))
            else:
                self.damaged += 1
        return found


def payload_of(data: bytes) -> bytes:
    """Return the payload of the first intact packet; nothing if there is none."""
    return next(iter(Reader().feed(data)), b"")


Way = Callable[[random.Random, bytes], bytes]
"""Turns a packet, with its 0x00, into what is sent."""


def _flip(draw: random.Random, data: bytes) -> bytes:
    held = bytearray(data)
    for _ in range(draw.choice((1, 1, 1, 2, 3, 8))):
        held[draw.randrange(len(held))] ^= 1 << draw.randrange(8)
    return bytes(held)


def _swap(draw: random.Random, data: bytes) -> bytes:
    held = bytearray(data)
    one, other = draw.randrange(len(held)), draw.randrange(len(held))
    held[one], held[other] = held[other], held[one]
    return bytes(held)


def _splice(make: Callable[[random.Random, bytes, int], bytes]) -> Way:
    """Return a way that draws a place in the packet."""
    return lambda draw, data: make(draw, data, draw.randrange(len(data)))


WAYS: Final[dict[str, Way]] = {
    "bits turned": _flip,
    "bytes swapped": _swap,
    "bytes lost": _splice(lambda draw, data, at: data[:at] + data[at + draw.choice((1, 2, 50, 400)) :]),
    "bytes twice": _splice(lambda draw, data, at: data[: at + draw.choice((1, 2, 64))] + data[at:]),
    "bytes between": _splice(lambda draw, data, at: data[:at] + draw.randbytes(draw.choice((1, 3, 40))) + data[at:]),
    "ends early": _splice(lambda draw, data, at: data[:at] + b"\0"),
    "no end": _splice(lambda draw, data, at: data[:at]),
    "no beginning": _splice(lambda draw, data, at: data[at:]),
    "a wrong check": lambda draw, data: packet(payload_of(data), draw.randrange(1, 2**32)),
    "noise before": lambda draw, data: bytes(draw.choices(range(1, 256), k=draw.choice((1, 7, 300)))) + data,
    "a flood": lambda draw, data: b"\x55" * draw.choice((1034, 5000, 70_000)) + b"\0" + data,
    "zeros": lambda draw, data: bytes(draw.choice((1, 500, 70_000))) + data + bytes(draw.choice((1, 500))),
    "garbage": lambda draw, data: draw.randbytes(draw.choice((100, 20_000))) + b"\0" + data,
    "too long": lambda draw, data: packet(b"\x82" + draw.randbytes(draw.choice((1024, 1025, 3000)))) + data,
    "no payload": lambda draw, data: packet(b"") + b"\xff\0\x01\0" + data,
}
"""By name."""

FRAME: Final = 0x82
TYPES: Final = (*range(0x01, 0x06), *range(0x10, 0x19), *range(0x80, 0x86))
ANSWERS: Final = {0x81: "<BBI", 0x83: "<BIHH", 0x85: "<I"}
"""Layouts of ACK, CONFIG_DATA and TIME behind the tag."""


def foreign(draw: random.Random, hello: bytes, frame: bytes) -> bytes:
    """Return the payload of an intact packet that is no frame of this device.

    Args:
        draw: Where it is drawn from.
        hello: The device's own HELLO, which nobody asked for now.
        frame: One of the device's own frames, whose head or length is changed.
    """
    size = draw.choice((0, 1, 7, 63, 254, 255, draw.randrange(1024), 1023))
    match draw.randrange(6):
        case 0:
            return bytes((draw.choice([kind for kind in range(256) if kind not in TYPES]),)) + draw.randbytes(size)
        case 1:
            return bytes((draw.choice([kind for kind in TYPES if kind != FRAME]),)) + draw.randbytes(size)
        case 2:  # an answer, with any tag
            kind = draw.choice(list(ANSWERS))
            fields = [draw.getrandbits(8) for _ in ANSWERS[kind][1:]]
            return bytes((kind, draw.randrange(256))) + struct.pack(ANSWERS[kind], *fields)
        case 3:  # an event that does not exist, or an overrun that did not happen
            return struct.pack("<BBII", 0x84, draw.choice((0, 4, 6, 7, 99, 255)), *(draw.getrandbits(32),) * 2)
        case 4:
            return hello[:1] + draw.randbytes(1) + hello[2:]
    held = bytearray(frame)
    match draw.randrange(4):
        case 0:
            return bytes(held[: draw.randrange(1, len(held))])
        case 1:
            return bytes(held) + draw.randbytes(draw.randrange(1, LARGEST - len(held)))
        case 2:
            held[2] = draw.choice((0, 1, 2, 3, 5, 255))
        case _:
            held[3] = draw.choice((0, 1, 103, 105, 208, 255))
    return bytes(held)
