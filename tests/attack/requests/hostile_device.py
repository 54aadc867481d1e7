"""A device with two configurations that answers requests for flashing, and lies; written from SPEC.md alone.

It is a line by itself: what is written to it is answered at once, and a read brings what was answered. It does what it
is asked to do, and then says something else.
"""

import random
import struct
from collections.abc import Callable
from typing import Final

import google_crc32c
from cobs import cobs

MOST_REQUESTS: Final = 1000
"""Whoever asks more often than this asks without end: a flash takes a dozen requests, a boot at most 200."""

HARDWARE: Final = 0x45533136


class Endless(Exception):
    """It was asked more than ``MOST_REQUESTS`` times."""


def packed(payload: bytes) -> bytes:
    """Return a packet."""
    return bytes(cobs.encode(payload + struct.pack("<I", google_crc32c.value(payload)))) + b"\0"


def configuration(name: bytes, rate_mHz: int) -> bytes:
    """Return a blob of 64 bytes."""
    body = struct.pack("<4sBBHII16sIIIIHHHHHBB", b"EITC", 1, 104, 64, HARDWARE, 1, name, 20_000, rate_mHz, 0, 1000,
                       100, 5, 8, 0xFFFF, 0, 3, 0)  # fmt: skip
    return body + struct.pack("<I", google_crc32c.value(body))


class HostileDevice:
    """A line to a device that lies.

    Args:
        lies: What each answer is replaced by; drawn anew for every answer. None of them: it is honest.
        seed: Of what it draws.
        share: How many of its answers are lies.
    """

    name, line_bytes_per_s = "a hostile device", 0

    def __init__(self, lies: list[str], seed: int = 0, share: float = 1.0) -> None:
        self._rng = random.Random(seed)
        self._lies, self._share = lies, share if lies else 0.0
        self._slots = [configuration(b"running", 200_000), configuration(b"before", 100_000)]
        self._generations = [3, 2]
        self._written = b""
        self._pending = 0
        self.confirmed = False
        self.requests = 0
        self._said = b""
        self._flood: Callable[[], bytes] | None = None

    @property
    def running(self) -> bytes:
        """The blob that runs."""
        return self._slots[0]

    def write(self, data: bytes) -> None:
        """Take bytes from the host."""
        for piece in data.split(b"\0"):
            if piece:
                self.requests += 1
                if self.requests > MOST_REQUESTS:
                    raise Endless(f"asked {self.requests} times")
                self._answer(cobs.decode(piece)[:-4])

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return what was said; nothing at once if there is nothing."""
        said, self._said = self._said, b""
        return said or (self._flood() if self._flood else b"")

    def cancel(self) -> None:
        """Nothing waits."""

    def report(self) -> list[str]:
        """Return nothing."""
        return []

    def close(self) -> None:
        """Nothing to give back."""

    def _answer(self, request: bytes) -> None:
        self._flood = None
        honest = self._honest(request)
        if self._rng.random() >= self._share:
            self._said += packed(honest)
            return
        lie = self._rng.choice(self._lies)
        made: bytes | None = LIES[lie](self._rng, request, honest)
        if made is not None:
            self._said += made
        if lie in ("events without end", "late answers without end"):
            again = made or b""
            self._flood = lambda: again * 20

    def _honest(self, request: bytes) -> bytes:
        kind, tag = request[0], request[1]
        if kind == 0x01:
            return self._hello(tag)
        if kind == 0x10:
            slot, offset, length = struct.unpack("<BHB", request[2:6])
            blob = self._slots[slot] if not self._pending or slot == 0 else self._written.ljust(64, b"\xff")
            generation = self._generations[slot] if not self._pending or slot == 0 else 0
            head = struct.pack("<BBBIHH", 0x83, tag, slot, generation, offset, 64)
            return head + blob[offset : offset + length]
        return struct.pack("<BBBBI", 0x81, tag, kind, 0, self._done(kind, request))

    def _hello(self, tag: int) -> bytes:
        blob = self._slots[0]
        return struct.pack(
            "<BB4sBB8s8s3BBI16sII16sIBBHHHIId", 0x80, tag, b"EITS", 1, 0, bytes.fromhex("0bff7f6e45fa7bc8"),
            bytes.fromhex("ef41b0aa6e17eb61"), 1, 0, 0, 0, HARDWARE, b"HOSTILE", int.from_bytes(blob[60:], "little"),
            self._generations[0], blob[16:32], 200_000, 104, 3, 0xFFFF, 0, 40, 1000, 92160, 1e-9,
        )  # fmt: skip

    def _done(self, kind: int, request: bytes) -> int:
        """Do what is asked and return the answer's detail."""
        if kind == 0x11:
            self._written, self._pending = b"", 1
            return 64
        if kind == 0x12:
            (offset,) = struct.unpack("<H", request[6:8])
            self._written = self._written[:offset] + request[8:]
            return len(self._written)
        if kind == 0x13:
            return int.from_bytes(self._written[60:64], "little")
        if kind == 0x14:
            self._pending = 4
            return 4
        if kind == 0x15:
            wanted = (self._generations[0], int.from_bytes(self._slots[0][60:], "little"))
            self.confirmed = struct.unpack("<II", request[2:10]) == wanted
            return self._generations[0]
        if kind == 0x16:
            self._pending = -1
            return self._generations[0]
        if kind == 0x18 and self._pending == 4 and len(self._written) == 64:
            self._slots, self._generations, self._pending = [self._written, self._slots[0]], [4, 3], 0
        elif kind == 0x18 and self._pending == -1:
            self._slots, self._generations, self._pending = self._slots[::-1], self._generations[::-1], 0
        return 0


Lie = Callable[[random.Random, bytes, bytes], bytes | None]
"""Returns bytes on the line instead of an honest answer to a request; None for silence."""


def _data(change: Callable[[random.Random, bytearray], None]) -> Lie:
    """Return a lie that bends CONFIG_DATA; other answers stay."""

    def lie(rng: random.Random, request: bytes, honest: bytes) -> bytes:
        bent = bytearray(honest)
        if honest[0] == 0x83:
            change(rng, bent)
        return packed(bytes(bent))

    return lie


def _ack(make: Callable[[random.Random, bytes], tuple[int, int, int]]) -> Lie:
    """Return a lie that is an ACK of (request's type, code, detail), whatever was asked."""
    return lambda rng, request, honest: packed(struct.pack("<BBBBI", 0x81, request[1], *make(rng, request)))


def _put(at: int, code: str, value: Callable[[random.Random], int]) -> Callable[[random.Random, bytearray], None]:
    return lambda rng, bent: struct.pack_into(code, bent, at, value(rng))


def _cut(rng: random.Random, bent: bytearray) -> None:
    del bent[11 + 4 * rng.randrange(8) :]


def _empty(rng: random.Random, bent: bytearray) -> None:
    del bent[11:]


def _more(rng: random.Random, bent: bytearray) -> None:
    bent += bytes(rng.choice((1, 4, 32, 900)))


def _flip(rng: random.Random, bent: bytearray) -> None:
    bent[rng.randrange(11, len(bent))] ^= 1 << rng.randrange(8)


def _escapes(rng: random.Random, request: bytes, honest: bytes) -> bytes:
    bent = bytearray(honest)
    if honest[0] == 0x80:
        bent[32:48] = b"\x1b]0;owned\x07\x1b[2J".ljust(16, b"\0")
    return packed(bytes(bent))


LIES: Final[dict[str, Lie]] = {
    "no data": _data(_empty),
    "less data": _data(_cut),
    "more data": _data(_more),
    "bent data": _data(_flip),
    "another slot": _data(_put(2, "<B", lambda rng: rng.choice((1, 2, 255)))),
    "another generation": _data(_put(3, "<I", lambda rng: rng.getrandbits(32))),
    "another offset": _data(_put(7, "<H", lambda rng: rng.choice((4, 64, 65535)))),
    "another size": _data(_put(9, "<H", lambda rng: rng.choice((0, 63, 65535)))),
    "another tag": lambda rng, request, honest: packed(honest[:1] + bytes([honest[1] ^ 0x55]) + honest[2:]),
    "busy": _ack(lambda rng, request: (request[0], 5, 0xFFFFFFFF)),
    "an unknown code": _ack(lambda rng, request: (request[0], rng.randrange(22, 256), rng.getrandbits(32))),
    "done, says the ACK": _ack(lambda rng, request: (request[0], 0, rng.choice((0, 32, 64, 0xFFFFFFFF)))),
    "an ACK of another request": _ack(lambda rng, request: (request[0] ^ 3, rng.choice((0, 5)), 0)),
    "refused for any reason": _ack(lambda rng, request: (request[0], rng.randrange(1, 22), rng.getrandbits(32))),
    "escape codes in texts": _escapes,
    "noise in a packet": lambda rng, request, honest: packed(
        bytes([rng.randrange(256), request[1]]) + rng.randbytes(40)
    ),
    "noise": lambda rng, request, honest: rng.randbytes(300),
    "bytes that end no packet": lambda rng, request, honest: b"\x55" * 100_000,
    "silence": lambda rng, request, honest: None,
    "events without end": lambda rng, request, honest: packed(struct.pack("<BBII", 0x84, 4, 0, 0)),
    "late answers without end": lambda rng, request, honest: packed(struct.pack("<BBI", 0x85, request[1] ^ 0x80, 0)),
    "half an answer": lambda rng, request, honest: packed(honest)[: len(honest) // 2],
    "the answer a thousand times": lambda rng, request, honest: packed(honest) * 1000,
}
