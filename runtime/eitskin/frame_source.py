"""Accepted frames of a device, one after the other: the loop that blocks in ``read``, and what to do when none come.

Silence, a reset or a port that returned: the device is greeted anew. What came before anybody asked, and what is stale
when time is short, is dropped for the newest. What the device says besides frames becomes events of the next one.
"""

import time
from collections.abc import Iterator
from typing import Final

from eitskin.acquisition.device import Device
from eitskin.errors import HandshakeError, PortReturned
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin_proto.wire.answers import Event
from eitskin_proto.wire.codes import MessageType
from eitskin_proto.wire.frames import FRAME_TYPE

LEISURE_S: Final = 0.001
"""The line rests if nothing comes for so long; what was published has been handed over by then."""

MOST_FRUITLESS: Final = 5
"""How often a device is greeted anew without a single payload in between."""

MOST_AT_ONCE: Final = 64
"""Payloads of which the newest is looked for; a device faster than this loop has its rest dropped next time."""


class FrameSource:
    """Reads a device and lets a pipeline accept its frames.

    Args:
        device: It answered the handshake.
        pipeline: Made for it.
    """

    def __init__(self, device: Device, pipeline: Pipeline) -> None:
        self._device, self._pipeline = device, pipeline
        self.recoveries = 0
        """How often the device was greeted anew after silence or a reset."""
        self.stopping = False
        self._started = False
        self._fruitless = 0
        self._heard_ns = time.perf_counter_ns()
        self._pending_events: tuple[str, ...] = ()

    def accepted(self, until_ns: int | None) -> Iterator[None]:
        """Yield whenever the pipeline has accepted a frame.

        What came before anybody asked is left out: a robot's first frame must not be an old one.

        Args:
            until_ns: When to end, on ``perf_counter_ns``; None goes on until ``stopping``.

        Raises:
            PortLost: The port vanished.
            HandshakeError: The device fell silent and does not answer, or came back as another one.
        """
        device, pipeline = self._device, self._pipeline
        self._start()
        backlog = True
        self._heard_ns = time.perf_counter_ns()
        while not self.stopping:
            wait_s = device.silence_s
            if until_ns is not None:
                wait_s = min(wait_s, (until_ns - time.perf_counter_ns()) * 1e-9)
                if wait_s <= 0:
                    return
            try:
                payloads = self._payloads(wait_s)
                if payloads and (backlog or pipeline.budget.drops_stale):
                    payloads = self._newest(payloads)
                    backlog = False
            except PortReturned:
                self._recover()
                continue
            read_ns = device.read_ns
            if not payloads:
                if not self.stopping and (read_ns - self._heard_ns) * 1e-9 >= device.silence_s:
                    self._recover()
                continue
            self._heard_ns = read_ns
            self._fruitless = 0
            held = device.held
            held.extend(payloads)
            while held:  # what is left when the caller stops asking comes again the next time
                payload = held.popleft()
                if payload[0] != FRAME_TYPE:
                    self._take_note(payload)
                elif pipeline.accept(payload, read_ns):
                    if self._pending_events:
                        pipeline.record.note(*self._pending_events)
                        self._pending_events = ()
                    yield
                    if self.stopping:
                        return
            if pipeline.intake.generation_differs:
                self._recover()

    def _payloads(self, wait_s: float) -> list[bytes]:
        """Return what comes, waiting for it; if nothing comes for a moment, do what can wait, and wait on."""
        if self._pipeline.has_leisure_work:
            if payloads := self._device.payloads(LEISURE_S):
                return payloads
            self._pipeline.look_at_health()
        return self._device.payloads(wait_s)

    def _start(self) -> None:
        """Start the stream with the first frame that is asked for: what nobody reads would only grow old."""
        if not self._started:
            self._started = True
            self._device.start()
            self._pipeline.clock.anchor(self._device.time_sample)

    def _newest(self, payloads: list[bytes]) -> list[bytes]:
        """Return what to compute when time is short: of all frames that wait, the newest."""
        while more := self._device.payloads(0.0):
            payloads += more
            if len(payloads) > MOST_AT_ONCE:
                break
        for payload in payloads[:-1]:
            if payload[0] == FRAME_TYPE:
                self._pipeline.intake.discard(payload)
            else:
                self._take_note(payload)
        return payloads[-1:]

    def _recover(self) -> None:
        if self._fruitless >= MOST_FRUITLESS:
            raise HandshakeError(
                f"{self._device.transport.name} answers and acknowledges START, but sent no frame after "
                f"{MOST_FRUITLESS} attempts: power the device off and on; if that does not help, flash it"
            )
        self._fruitless += 1
        while True:
            try:
                self._device.recover()
                break
            except PortReturned:
                continue  # it vanished once more while it was greeted
        self.recoveries += 1
        self._pipeline.greet(self._device.hello)
        self._pipeline.clock.anchor(self._device.time_sample)
        self._pending_events = (*self._pending_events, "recovered")
        self._heard_ns = time.perf_counter_ns()

    def _take_note(self, payload: bytes) -> None:
        if payload[0] == MessageType.EVENT and len(payload) == Event.LAYOUT.size and len(self._pending_events) < 8:
            self._pending_events = (*self._pending_events, f"device:{Event.unpack(payload).text.lower()}")
