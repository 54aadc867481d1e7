"""A device behind a transport in this process: it answers requests and streams, and an attack decides what it sends.

``send(line, n)`` gives the bytes of the n-th scan. By the clock a scan comes every 10 ms, as from a device; without it
the next one is there as soon as it is read, so that thousands of frames take seconds.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from threading import Event as Flag

import numpy as np

from eitskin.errors import PortLost, PortReturned
from eitskin_proto.wire import messages
from eitskin_proto.wire.codes import Code, EventCode, MessageType
from eitskin_proto.wire.frames import Frame
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_proto.wire.messages import Ack, Hello

HELLO = Hello(
    firmware_version=(1, 0, 0), hardware_id=1, serial_number="LIAR-1", configuration_digest=1, generation=3,
    configuration_name="attack", rate_mHz=100_000, rows=104, sample_bytes=4, volts_per_count=1e-9,
)  # fmt: skip

FLAT = np.geomspace(4e6, 1e4, 104)

PATTERNS = 2048
"""Different scans, over and over: what a frame holds follows from its sequence number."""

_NOISE = 1e-3 * np.random.default_rng(5).standard_normal((PATTERNS, 104))


@dataclass
class Line:
    """A transport with a device behind it; ``hello``, ``mute`` and ``send`` may be changed while it runs."""

    send: Callable[["Line", int], bytes]
    hello: Hello = HELLO
    clocked: bool = True
    scans_left: int = -1
    """After so many scans the line is gone; negative for never."""
    patience_s: float = 0.0
    mute: bool = False
    """It hangs: no answer, no frame."""
    garble: Callable[[bytes], bytes] = bytes
    """What becomes of the packet of an answer."""
    name: str = "lying line"
    line_bytes_per_s: int = 0
    greeted: int = 0
    scans: int = 0
    sequence: int = 0
    clock_us: int = 0
    hooks: list[Callable[["Line"], None]] = field(default_factory=list)
    """Called at every read."""

    def __post_init__(self) -> None:
        self._deframer = Deframer()
        self._out = b""
        self._streaming = False
        self._cancelled = Flag()
        self._next_s = 0.0
        self.rng = np.random.default_rng(5)

    def write(self, data: bytes) -> None:
        for payload in self._deframer.feed(data):
            if not self.mute:
                self._out += self.garble(encode(self._answer(payload[0], payload[1])))

    def _answer(self, kind: int, tag: int) -> bytes:
        if kind == MessageType.HELLO_REQUEST:
            self.greeted += 1
            return replace(self.hello, tag=tag).pack()
        if kind == MessageType.TIME_REQUEST:
            return messages.Time(_now_us(), tag).pack()
        self._streaming = kind != MessageType.STOP
        self._next_s = time.perf_counter()
        return Ack(kind, Code.OK, 0, tag).pack()

    def read(self, timeout_s: float | None = None) -> bytes:
        for hook in self.hooks:
            hook(self)
        end_s = time.perf_counter() + (60.0 if timeout_s is None else timeout_s)
        while not self._cancelled.is_set():
            if not self._out and self._streaming and not self.mute and self._due(timeout_s):
                if self.scans == self.scans_left:
                    raise PortLost(f"{self.name}: unplugged")
                self._out = self.send(self, self.scans)
                self.scans += 1
            if self._out:
                data, self._out = self._out, b""
                return data
            left_s = end_s - time.perf_counter()
            if left_s <= 0:
                return b""
            self._cancelled.wait(min(left_s, 0.01))
        self._cancelled.clear()
        return b""

    def _due(self, timeout_s: float | None) -> bool:
        if not self.clocked:
            return timeout_s is None or timeout_s > 0  # one at a time: none waits behind another
        now_s = time.perf_counter()
        if now_s < self._next_s:
            return False
        self._next_s = max(self._next_s + 1e3 / HELLO.rate_mHz, now_s - 0.05)
        return True

    def payload(self, **fields: object) -> bytes:
        """Return the payload of an honest frame, but for some fields."""
        self.sequence = (self.sequence + 1) % 2**32
        self.clock_us = (_now_us() if self.clocked else self.clock_us + 10_000) % 2**32
        counts = np.rint(FLAT * (1.0 + _NOISE[self.sequence % PATTERNS])).astype(np.int32)
        sent = Frame(self.sequence, self.clock_us, counts, generation=self.hello.generation)
        return replace(sent, **fields).pack()  # type: ignore[arg-type]

    def frame(self, **fields: object) -> bytes:
        """Return the packet of an honest frame, but for some fields."""
        return encode(self.payload(**fields))

    def event(self, code: EventCode) -> bytes:
        """Return the packet of an event."""
        return encode(messages.Event(code, 0, self.scans).pack())

    def reopen(self) -> None:
        raise PortReturned(f"{self.name} is open again")

    def cancel(self) -> None:
        self._cancelled.set()

    def report(self) -> list[str]:
        return []

    def close(self) -> None:
        pass


def _now_us() -> int:
    return int(time.perf_counter() * 1e6) % 2**32
