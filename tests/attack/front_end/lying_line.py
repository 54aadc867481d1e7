"""Devices that hang, flood or lie, each behind a line in this process: what the frame source makes of them.

A line is a transport; what is behind it answers requests, and streams by the clock once it was started.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from threading import Event as Flag

import numpy as np

from eitskin.errors import PortReturned
from eitskin_proto.wire import messages
from eitskin_proto.wire.codes import Code, EventCode, MessageType
from eitskin_proto.wire.frames import Frame
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_proto.wire.messages import Ack, Hello

HELLO = Hello(
    firmware_version=(1, 0, 0), hardware_id=1, serial_number="LIAR-1", configuration_digest=1, generation=3,
    configuration_name="attack", rate_mHz=100_000, rows=104, sample_bytes=4, volts_per_count=1e-9,
)  # fmt: skip

FLAT = np.where(np.arange(104) % 3, -1.0, 1.0) * np.geomspace(4e6, 1e4, 104)


@dataclass
class Line:
    """A transport with a device behind it.

    ``send(line, n)`` gives the bytes of its n-th scan; ``behave`` may be changed while it runs.
    """

    send: Callable[["Line", int], bytes]
    hello: Hello = HELLO
    patience_s: float = 0.0
    mute: bool = False
    """It hangs: no answer, no frame."""
    name: str = "lying line"
    line_bytes_per_s: int = 0
    gone: bool = False
    greeted: int = 0
    started: int = 0
    reopened: int = 0
    scans: int = 0
    sequence: int = 0
    hooks: list[Callable[["Line"], None]] = field(default_factory=list)
    """Called at every read."""

    def __post_init__(self) -> None:
        self._deframer = Deframer()
        self._out = b""
        self._streaming = False
        self._woken = Flag()
        self._next_s = 0.0
        self.rng = np.random.default_rng(5)

    def write(self, data: bytes) -> None:
        for payload in self._deframer.feed(data):
            if not self.mute:
                self._answer(payload)

    def _answer(self, payload: bytes) -> None:
        kind, tag = payload[0], payload[1]
        if kind == MessageType.HELLO_REQUEST:
            self.greeted += 1
            self._out += encode(replace(self.hello, tag=tag).pack())
        elif kind == MessageType.TIME_REQUEST:
            self._out += encode(messages.Time(int(time.perf_counter() * 1e6) & 0xFFFFFFFF, tag).pack())
        else:
            self._streaming = kind != MessageType.STOP
            self.started += kind == MessageType.START
            self._next_s = time.perf_counter()
            self._out += encode(Ack(kind, Code.OK, 0, tag).pack())

    def read(self, timeout_s: float | None = None) -> bytes:
        for hook in self.hooks:
            hook(self)
        end_s = time.perf_counter() + (60.0 if timeout_s is None else timeout_s)
        while not self._woken.is_set():
            if self._streaming and not self.mute and time.perf_counter() >= self._next_s:
                self._next_s = max(self._next_s + 1e3 / HELLO.rate_mHz, time.perf_counter() - 0.05)
                self._out += self.send(self, self.scans)
                self.scans += 1
            if self._out:
                data, self._out = self._out, b""
                return data
            left_s = end_s - time.perf_counter()
            if left_s <= 0:
                return b""
            self._woken.wait(min(left_s, 0.01))
        self._woken.clear()
        return b""

    def frame(self, **fields: object) -> bytes:
        """Return the packet of an honest frame, but for some fields."""
        self.sequence += 1
        counts = np.rint(FLAT * (1.0 + 1e-3 * self.rng.standard_normal(104))).astype(np.int32)
        sent = Frame(self.sequence, self.sequence * 10_000, counts, generation=self.hello.generation)
        return encode(replace(sent, **fields).pack())  # type: ignore[arg-type]

    def event(self, code: EventCode) -> bytes:
        """Return the packet of an event."""
        return encode(messages.Event(code, 0, self.scans).pack())

    def reopen(self) -> None:
        self.reopened += 1
        raise PortReturned(f"{self.name} is open again")

    def cancel(self) -> None:
        self._woken.set()

    def report(self) -> list[str]:
        return []

    def close(self) -> None:
        pass
