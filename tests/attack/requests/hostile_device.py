"""A device that answers the requests of ``eitskin flash``, and lies: the virtual skin behind a line that bends answers.

What is written to the line is answered at once, and a read brings what was answered. The device does what it is asked
to do; what comes of it is another matter.
"""

import random
import struct
from collections.abc import Callable
from typing import Final

import numpy as np

from eitskin_proto.wire import config_toml
from eitskin_proto.wire.framing import Deframer
from eitskin_tools.virtual_skin.device import Identity, VirtualDevice

from ..line.damage import packet, payload_of

MOST_REQUESTS: Final = 1000
"""A host that asks more often than this asks without end: a flash takes a dozen requests, a boot at most 200."""


class EndlessError(Exception):
    """It was asked more than ``MOST_REQUESTS`` times."""


class Still:
    """Voltages that do not change."""

    def voltages(self, time_s: float) -> np.ndarray:
        return np.linspace(-0.1, -0.001, 104)


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
        self._lies, self.share = lies, share if lies else 0.0
        self._now_ns = 1_000_000_000
        self._device = VirtualDevice(Still(), config_toml.named("paper"), self._now_ns, Identity("HOSTILE"))
        self._deframer = Deframer()
        self._requests = 0
        self._answers = self._flood = b""

    @property
    def running(self) -> tuple[bytes, bool]:
        """The blob that runs, and whether it was confirmed."""
        store = self._device.store
        return store.configuration.to_blob(), not store.on_trial

    def write(self, data: bytes) -> None:
        """Take bytes from the host."""
        for request in self._deframer.feed(data):
            self._requests += 1
            if self._requests > MOST_REQUESTS:
                raise EndlessError(f"asked {self._requests} times")
            self._now_ns += 1_000_000
            said = self._device.receive(packet(request), self._now_ns)
            said += self._device.poll(self._now_ns + 1_000_000_000) if request[0] == 0x18 else []
            self._flood = b""
            for one in said:
                self._answers += self._bent(request, payload_of(one))

    def _bent(self, request: bytes, honest: bytes) -> bytes:
        if self._rng.random() >= self.share:
            return packet(honest)
        lie = self._rng.choice(self._lies)
        made = LIES[lie](self._rng, request, honest)
        if lie.endswith("without end"):
            self._flood = made * 20
        return made

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return what was answered; nothing at once if there is nothing."""
        answers, self._answers = self._answers, b""
        return answers or self._flood

    def cancel(self) -> None:
        """Nothing waits."""

    def report(self) -> list[str]:
        """Return nothing."""
        return []

    def close(self) -> None:
        """Nothing to give back."""


Lie = Callable[[random.Random, bytes, bytes], bytes]
"""Returns bytes on the line instead of an honest answer to a request."""


def _data(change: Callable[[random.Random, bytearray], None]) -> Lie:
    """Return a lie that bends CONFIG_DATA; other answers stay."""

    def lie(rng: random.Random, request: bytes, honest: bytes) -> bytes:
        bent = bytearray(honest)
        if honest[0] == 0x83:
            change(rng, bent)
        return packet(bytes(bent))

    return lie


def _ack(make: Callable[[random.Random, bytes], tuple[int, int, int]]) -> Lie:
    """Return a lie that is an ACK of (request's type, code, detail), whatever was asked."""
    return lambda rng, request, honest: packet(struct.pack("<BBBBI", 0x81, request[1], *make(rng, request)))


def _put(at: int, code: str, *values: int) -> Callable[[random.Random, bytearray], None]:
    """Return a change to another value than is there."""

    def put(rng: random.Random, bent: bytearray) -> None:
        (honest,) = struct.unpack_from(code, bent, at)
        struct.pack_into(code, bent, at, rng.choice([value for value in values if value != honest]))

    return put


def _cut(rng: random.Random, bent: bytearray) -> None:
    del bent[11 + 4 * rng.randrange(8) :]


def _more(rng: random.Random, bent: bytearray) -> None:
    bent += bytes(rng.choice((1, 4, 32, 900)))


def _flip(rng: random.Random, bent: bytearray) -> None:
    bent[rng.randrange(11, len(bent))] ^= 1 << rng.randrange(8)


def _escapes(rng: random.Random, request: bytes, honest: bytes) -> bytes:
    bent = bytearray(honest)
    if honest[0] == 0x80:
        bent[32:48] = b"\x1b]0;owned\x07\x1b[2J".ljust(16, b"\0")
    return packet(bytes(bent))


LIES: Final[dict[str, Lie]] = {
    "less data": _data(_cut),
    "more data": _data(_more),
    "bent data": _data(_flip),
    "another slot": _data(_put(2, "<B", 1, 2, 255)),
    "another offset": _data(_put(7, "<H", 4, 64, 65535)),
    "another size": _data(_put(9, "<H", 0, 63, 65535)),
    "an unknown code": _ack(lambda rng, request: (request[0], rng.randrange(22, 256), rng.getrandbits(32))),
    "done, says the ACK": _ack(lambda rng, request: (request[0], 0, rng.choice((0, 32, 64, 0xFFFFFFFF)))),
    "refused for any reason": _ack(lambda rng, request: (request[0], rng.randrange(1, 22), rng.getrandbits(32))),
    "escape codes in texts": _escapes,
    "noise": lambda rng, request, honest: rng.randbytes(300),
    "silence": lambda rng, request, honest: b"",
    "events without end": lambda rng, request, honest: packet(struct.pack("<BBII", 0x84, 4, 0, 0)),
    "late answers without end": lambda rng, request, honest: packet(struct.pack("<BBI", 0x85, request[1] ^ 0x80, 0)),
    "the answer a thousand times": lambda rng, request, honest: packet(honest) * 1000,
}
"""By name."""
