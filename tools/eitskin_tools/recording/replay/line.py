"""A line behind which a recording plays the device: the runtime reads it as it reads a port.

It answers the handshake with the HELLO that was recorded, acknowledges what is asked of it, and from START on sends the
frames as they came: at their pace, or one as soon as the one before is done. What belongs before a frame, such as a
cloud, is done in the reader's thread when the frame before it is done, so that each frame meets what it met then.
Played again and again, sequence numbers and the device's clock go on.
"""

import struct
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from queue import Empty, SimpleQueue
from time import perf_counter_ns
from typing import Final

from eitskin_proto.wire.answers import Ack, Hello, Time
from eitskin_proto.wire.codes import Code, MessageType
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_tools.recording.script import Step

_SEQUENCE: Final = struct.Struct("<II")
_AT: Final = 8
"""Where sequence and device_us stand in a frame's payload."""

LEAST_GAP_US: Final = 1000
"""Between the last frame of one round and the first of the next, where one frame is all that there is."""


class RecordedLine:
    """A :class:`eitskin.acquisition.transport.Transport` that plays steps.

    Args:
        name: What people call it.
        hello: Of the device.
        steps: Gives the steps anew for every round.
        paced: Send each frame when its time has come; else as soon as the one before is done.
        loop: Begin again at the end.
        speed: How many times faster than they came.
    """

    line_bytes_per_s = 0

    def __init__(
        self,
        name: str,
        hello: Hello,
        steps: Callable[[], Iterator[Step]],
        *,
        paced: bool = True,
        loop: bool = False,
        speed: float = 1.0,
    ) -> None:
        self.name = name
        self.before: Callable[[Step], None] = lambda _: None
        """Does what belongs before a frame."""
        self.ended: Callable[[], None] = lambda: None
        """Called once, behind the last frame."""
        self.sent = 0
        """Frames so far."""
        self.rounds = 0
        """Ends of the recording that were met so far."""
        self._hello, self._make, self._paced, self._loop, self._speed = hello, steps, paced, loop, speed
        self._steps = steps()
        self._deframer = Deframer()
        self._answers: deque[bytes] = deque()
        self._wakes: SimpleQueue[None] = SimpleQueue()  # a signal handler may put into it amid a wait, as into no Event
        self._cancelled = False
        self._streaming = self._over = False
        self._next: Step | None = None
        self._start_ns = self._first_log_ns = self._last_log_ns = 0
        self._first: tuple[int, int] | None = None
        self._last = self._ahead = 0, 0

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return answers, or one frame whose time has come; nothing after the timeout or ``cancel``."""
        if self._answers:
            found = b"".join(self._answers)
            self._answers.clear()
            return found
        deadline_ns = None if timeout_s is None else perf_counter_ns() + int(timeout_s * 1e9)
        step = self._upcoming() if self._streaming and timeout_s != 0.0 else None
        while True:
            now_ns = perf_counter_ns()
            due_ns = None if step is None else self._due_ns(step, now_ns)
            if step is not None and due_ns is not None and now_ns >= due_ns:
                self._next, self._last_log_ns = None, step.log_ns
                self.sent += 1
                return encode(self._renumbered(step.frame.payload))
            if self._cancelled:
                self._cancelled = False
                return b""
            moments = [moment for moment in (deadline_ns, due_ns) if moment is not None]
            wait_ns = min(moments) - now_ns if moments else None
            if deadline_ns is not None and now_ns >= deadline_ns:
                return b""
            with suppress(Empty):
                self._wakes.get(timeout=None if wait_ns is None else max(wait_ns, 0) * 1e-9)

    @property
    def pause_s(self) -> float:
        """How long after the last frame the next one is due: a gap of the recording is no silence of the device."""
        step = self._next
        if step is None or not self._paced or not self._last_log_ns:
            return 0.0
        return max(step.log_ns - self._last_log_ns, 0) * 1e-9 / self._speed

    def _upcoming(self) -> Step | None:
        """Return the step to come, everything done that belongs before it; None at the end."""
        if self._next is None and not self._over:
            self._next = next(self._steps, None)
            if self._next is None:
                self._next = self._next_round()
            if self._next is not None:
                self.before(self._next)
        return self._next

    def _next_round(self) -> Step | None:
        self.rounds += 1
        if self._loop and self._first is not None:
            first, last = self._first, self._last
            gap_us = max((last[1] - first[1]) // max(last[0] - first[0], 1), LEAST_GAP_US)
            self._ahead = self._ahead[0] + last[0] + 1 - first[0], self._ahead[1] + last[1] + gap_us - first[1]
            self._start_ns = 0
            self._steps = self._make()
            self._first = None
            if (found := next(self._steps, None)) is not None:
                return found
        self._over = True
        self.ended()
        return None

    def _due_ns(self, step: Step, now_ns: int) -> int:
        if not self._paced:
            return now_ns
        if not self._start_ns:
            self._start_ns, self._first_log_ns = now_ns, step.log_ns
        return self._start_ns + int((step.log_ns - self._first_log_ns) / self._speed)

    def _renumbered(self, payload: bytes) -> bytes:
        """Return a frame that goes on where the round before ended."""
        if len(payload) < _AT + _SEQUENCE.size:
            return payload
        found = _SEQUENCE.unpack_from(payload, _AT)
        self._first = self._first or found
        self._last = found
        if self._ahead == (0, 0):
            return payload
        whole = bytearray(payload)
        _SEQUENCE.pack_into(whole, _AT, *((a + b) & 0xFFFFFFFF for a, b in zip(found, self._ahead, strict=True)))
        return bytes(whole)

    def write(self, data: bytes) -> None:
        """Take requests; their answers come with the next ``read``."""
        for payload in self._deframer.feed(data):
            if answer := self._answer(payload):
                self._answers.append(encode(answer))
        self._wakes.put(None)

    def _answer(self, payload: bytes) -> bytes:
        kind, tag = payload[0], payload[1] if len(payload) > 1 else 0
        if kind == MessageType.HELLO_REQUEST:
            return replace(self._hello, tag=tag).pack()
        if kind == MessageType.TIME_REQUEST:
            return Time(self._device_us(), tag).pack()
        if kind == MessageType.START:
            self._streaming = True
        elif kind == MessageType.STOP:
            self._streaming = False
        elif kind != MessageType.SET_MODE:  # which idle frames were recorded, their own mode says
            return Ack(kind, Code.UNKNOWN_TYPE, len(payload), tag).pack()
        return Ack(kind, Code.OK, 0, tag).pack()

    def _device_us(self) -> int:
        """Return the device's clock: that of the frame to come, less what is left until it is sent."""
        if self._next is None and not self._over:
            self._next = next(self._steps, None)
            if self._next is not None:
                self.before(self._next)
        if self._next is None or len(self._next.frame.payload) < _AT + _SEQUENCE.size:
            return 0
        step, now_ns = self._next, perf_counter_ns()
        left_us = int(max(self._due_ns(step, now_ns) - now_ns, 0) * self._speed) // 1000 if self._start_ns else 0
        return int(_SEQUENCE.unpack_from(step.frame.payload, _AT)[1] + self._ahead[1] - left_us) & 0xFFFFFFFF

    def cancel(self) -> None:
        """Make the ``read`` that waits now, or else the next one, return at once; safe in a signal handler."""
        self._cancelled = True
        self._wakes.put(None)

    def report(self) -> list[str]:
        """Return how it is played, a line for people."""
        how = f"at {self._speed:g} times its pace" if self._paced else "as fast as possible"
        return [f"{self.name}: played {how}{', again and again' if self._loop else ''}"]

    def close(self) -> None:
        """End it; closing twice is fine."""
        self._over = True
        self._wakes.put(None)
