"""Intact packets that are no frames, between frames that are: what a newer, an older or a mad device may say.

A host reads what it knows and asked for, and steps over the rest; every frame in between is published.
"""

import random
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from . import codec
from .hostile import Attack

if TYPE_CHECKING:
    from .process import Machine

Maker = Callable[[random.Random, "Machine"], bytes]


def unknown(draw: random.Random, machine: "Machine") -> bytes:
    """A type that nobody knows, of any length."""
    kind = draw.choice([number for number in range(256) if number not in codec.LAYOUTS])
    return bytes((kind,)) + draw.randbytes(draw.choice((0, 1, 7, 63, 64, 254, 255, 1023, draw.randrange(1024))))


def misshapen(draw: random.Random, machine: "Machine") -> bytes:
    """A known type but FRAME, of any length."""
    kind = draw.choice([number for number in codec.LAYOUTS if number != codec.FRAME])
    return bytes((kind,)) + draw.randbytes(draw.choice((0, 1, 5, 6, 98, 100, 1023, draw.randrange(1024))))


def answer(draw: random.Random, machine: "Machine") -> bytes:
    """An answer that nobody asked for, with any tag."""
    tag, kind = draw.randrange(256), draw.choice((codec.ACK, codec.TIME, codec.CONFIG_DATA))
    if kind == codec.ACK:
        return codec.pack(kind, tag, draw.choice((*codec.LAYOUTS, 0xEE)), draw.randrange(256), draw.getrandbits(32))
    if kind == codec.TIME:
        return codec.pack(kind, tag, draw.getrandbits(32))
    tail = draw.randbytes(draw.randrange(33))
    return codec.pack(kind, tag, draw.randrange(256), draw.getrandbits(32), *(draw.getrandbits(16),) * 2, tail=tail)


def event(draw: random.Random, machine: "Machine") -> bytes:
    """An event that does not exist; or an overrun that did not happen."""
    code = draw.choice((0, codec.OVERRUN, 6, 7, 99, 255))
    return codec.pack(codec.EVENT, code, draw.getrandbits(32), draw.getrandbits(32))


def greeting(draw: random.Random, machine: "Machine") -> bytes:
    """The device's own HELLO, unasked, with any tag."""
    return machine.device.hello(draw.randrange(256))


def request(draw: random.Random, machine: "Machine") -> bytes:
    """A host's request, sent by the device."""
    kind = draw.choice([number for number in codec.LAYOUTS if number < 0x80])
    return bytes((kind,)) + draw.randbytes(draw.randrange(40))


def frame_like(draw: random.Random, machine: "Machine") -> bytes:
    """A FRAME whose length or table is not this device's: withheld, and counted."""
    whole = machine.last or machine.device.hello(0)
    held = bytearray(whole)
    match draw.randrange(4):
        case 0:
            return bytes(held[: draw.randrange(1, len(held))])
        case 1:
            return bytes(held) + draw.randbytes(draw.randrange(1, 1024 - len(held)))
        case 2:
            held[2] = draw.choice((0, 1, 2, 4, 5, 255))
        case _:
            held[3] = draw.choice((0, 1, 103, 105, 208, 255))
    return bytes(held)


MAKERS: Final[tuple[Maker, ...]] = (unknown, misshapen, answer, event, greeting, request, frame_like)


class Foreign(Attack):
    """Up to three of them before every frame."""

    def send(self, payload: bytes) -> bool:
        wanted = self.order.get("makers")
        makers = [maker for maker in MAKERS if wanted is None or maker.__name__ in wanted]
        for _ in range(self.random.randrange(4)):
            self.machine.put(codec.packet(self.random.choice(makers)(self.random, self.machine)))
        return False


class Lengths(Attack):
    """Before every frame a packet of the next length, 1 to 1024, of a type that nobody knows; then of FRAME's."""

    _length = 0

    def send(self, payload: bytes) -> bool:
        for _ in range(12):
            self._length = self._length % 2048 + 1
            kind = 0xF0 if self._length <= 1024 else codec.FRAME
            size = (self._length - 1) % 1024
            if kind == codec.FRAME and size + 1 == len(payload):
                continue
            self.machine.put(codec.packet(bytes((kind,)) + self.random.randbytes(size)))
        return False


class Torrent(Attack):
    """Intact packets that are no frames, as many as the host takes, and the frames in between."""

    def idle(self) -> None:
        while len(self.machine.line.waiting) < 32768:
            self.machine.put(codec.packet(self.random.choice(MAKERS[:3])(self.random, self.machine)))
        super().idle()


class Stored(Attack):
    """Answers a CONFIG_READ with nonsense: ``kind`` says which."""

    def request(self, payload: bytes) -> bool:
        if payload[0] != codec.READ:
            return False
        _, tag, slot, offset = payload[0], payload[1], payload[2], int.from_bytes(payload[3:5], "little")
        data = bytes(self.machine.device.store.running[offset : offset + payload[5]])
        match self.order["kind"]:
            case "empty":
                said = codec.pack(codec.CONFIG_DATA, tag, slot, 1, offset, 64)
            case "short":
                said = codec.pack(codec.CONFIG_DATA, tag, slot, 1, offset, 64, tail=data[:1])
            case "elsewhere":
                said = codec.pack(codec.CONFIG_DATA, tag, slot, 1, 0, 64, tail=data)
            case "endless":
                said = codec.pack(codec.CONFIG_DATA, tag, slot, 1, offset, 65_535, tail=bytes(32))
            case "none":
                said = codec.pack(codec.CONFIG_DATA, tag, slot, 1, offset, 0)
            case "random":
                fields = (self.random.getrandbits(32), offset, 64)
                said = codec.pack(codec.CONFIG_DATA, tag, slot, *fields, tail=self.random.randbytes(payload[5] % 33))
            case "done":
                said = codec.pack(codec.ACK, tag, codec.READ, codec.OK, 0)
            case "unknown":
                said = codec.pack(codec.ACK, tag, codec.READ, 200, 0)
            case "other":
                said = codec.pack(codec.ACK, tag, codec.START, codec.OK, 0)
            case kind:
                raise ValueError(kind)
        self.machine.put(codec.packet(said))
        return True


KNOWN: Final[dict[str, type[Attack]]] = {"foreign": Foreign, "lengths": Lengths, "torrent": Torrent, "stored": Stored}
