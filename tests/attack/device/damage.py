"""Damage on the wire: what noise, a loose plug or a wrong rate does to bytes. No packet is forged.

An episode is a few scans of which a part is damaged in one or several of the ways below, then a few whole ones. Each
has a seed of its own, so that one alone can be seen again.
"""

import random
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from . import codec
from .hostile import Attack

if TYPE_CHECKING:
    from .process import Machine

Way = Callable[[random.Random, bytes], bytes]
"""Turns a packet, with its 0x00, into what is sent."""


def _at(draw: random.Random, data: bytes) -> int:
    return draw.randrange(len(data))


def flip(draw: random.Random, data: bytes) -> bytes:
    """Turn one to eight bits over, perhaps the last 0x00's."""
    held = bytearray(data)
    for _ in range(draw.choice((1, 1, 1, 2, 3, 8))):
        held[_at(draw, data)] ^= 1 << draw.randrange(8)
    return bytes(held)


def drop(draw: random.Random, data: bytes) -> bytes:
    """Lose some bytes in a row."""
    at = _at(draw, data)
    return data[:at] + data[at + draw.choice((1, 1, 2, 50, 400)) :]


def double(draw: random.Random, data: bytes) -> bytes:
    """Send a run of bytes twice."""
    at = _at(draw, data)
    run = data[at : at + draw.choice((1, 1, 2, 64))]
    return data[:at] + run + data[at:]


def swap(draw: random.Random, data: bytes) -> bytes:
    """Exchange two bytes."""
    held = bytearray(data)
    one, other = _at(draw, data), _at(draw, data)
    held[one], held[other] = held[other], held[one]
    return bytes(held)


def insert(draw: random.Random, data: bytes) -> bytes:
    """Put foreign bytes in, zeros among them."""
    at = _at(draw, data)
    return data[:at] + draw.randbytes(draw.choice((1, 3, 40))) + data[at:]


def cut(draw: random.Random, data: bytes) -> bytes:
    """End a packet too early."""
    return data[: _at(draw, data)] + b"\0"


def join(draw: random.Random, data: bytes) -> bytes:
    """Lose the end, so that the next packet hangs on to it."""
    return data[: _at(draw, data)]


def behead(draw: random.Random, data: bytes) -> bytes:
    """Lose the beginning."""
    return data[_at(draw, data) :]


def check(draw: random.Random, data: bytes) -> bytes:
    """Give it another check."""
    payload = codec.unpacket(data[:-1])
    wrong = codec.crc32c(payload) ^ draw.randrange(1, 2**32)
    return codec.stuff(payload + struct.pack("<I", wrong)) + b"\0"


def noise(draw: random.Random, data: bytes) -> bytes:
    """Send noise before it, without an end: both are one damaged packet."""
    return bytes(draw.choices(range(1, 256), k=draw.choice((1, 7, 300)))) + data


def endless(draw: random.Random, data: bytes) -> bytes:
    """Send very many bytes without 0x00, then an end and the whole packet."""
    return b"\x55" * draw.choice((1034, 1100, 5000, 70_000)) + b"\0" + data


def zeros(draw: random.Random, data: bytes) -> bytes:
    """Send many empty packets around it, which are no error."""
    return bytes(draw.choice((1, 2, 500))) + data + bytes(draw.choice((1, 2, 500)))


def overlong(draw: random.Random, data: bytes) -> bytes:
    """Send an intact packet that is longer than any may be, then the whole one."""
    return codec.packet(b"\x82" + draw.randbytes(draw.choice((1024, 1025, 3000)))) + data


def bodiless(draw: random.Random, data: bytes) -> bytes:
    """Send packets of a check alone, of less, and of one code byte, then the whole one."""
    return codec.packet(b"") + codec.stuff(draw.randbytes(draw.randrange(4))) + b"\0" + b"\xff\0" + data


WAYS: Final[tuple[Way, ...]] = (
    *(flip, drop, double, swap, insert, cut, join, behead, check, noise, endless, zeros, overlong, bodiless),
)
SCANS: Final = 8
WHOLE: Final = 4
"""Scans of an episode, and of them the last ones that are whole."""


class Episodes(Attack):
    """Damage, an episode after the other, each from its own seed: the attack's and the episode's number."""

    def __init__(self, machine: "Machine", order: dict[str, Any]) -> None:
        super().__init__(machine, order)
        self._number = -1
        self._first = machine.made
        self._ways: tuple[Way, ...] = ()

    def send(self, payload: bytes) -> bool:
        scans = self.machine.made - self._first
        number = order if (order := self.order.get("only")) is not None else scans // SCANS
        if payload[0] == codec.FRAME and (scans // SCANS > self._number):
            self._number = scans // SCANS
            self.random = random.Random(self.seed * 1_000_003 + number)
            self._ways = tuple(self.random.sample(WAYS, self.random.choice((1, 1, 2, 3))))
            said = [way.__name__ for way in self._ways]
            self.machine.episodes.append((number, int.from_bytes(payload[8:12], "little"), said))
        if scans % SCANS >= SCANS - WHOLE:
            return False
        data = codec.packet(payload)
        for way in self._ways:
            if self.random.random() < 0.6:
                try:
                    data = way(self.random, data) or b"\0"
                except ValueError:  # it was damaged before
                    continue
        self.machine.put(data)
        return True

    def end(self) -> None:
        self.machine.put(b"\0")
        super().end()


class Flood(Attack):
    """Bytes without an end for as long as it lasts, as fast as the host takes them; no frame gets through."""

    def send(self, payload: bytes) -> bool:
        return True

    def idle(self) -> None:
        if len(self.machine.line.waiting) < 65536:
            self.machine.put(self._bytes())
        super().idle()

    def _bytes(self) -> bytes:
        return bytes((self.random.randrange(1, 256),)) * 65536

    def end(self) -> None:
        self.machine.put(b"\0")
        super().end()


class Ends(Flood):
    """Nothing but 0x00."""

    def _bytes(self) -> bytes:
        return bytes(65536)


class Garbage(Flood):
    """Random bytes."""

    def _bytes(self) -> bytes:
        return self.random.randbytes(65536)


KNOWN: Final[dict[str, type[Attack]]] = {"damage": Episodes, "flood": Flood, "ends": Ends, "garbage": Garbage}
