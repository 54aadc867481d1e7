"""Accepted frames of a device, one after the other: the loop that blocks in ``read``, and what to do when none come.

Silence, a reset, a port that returned: the device is greeted anew. Silence is what brings no frame of the device's
configuration, whatever else comes; and where frames come of which none can be used, it is started anew as well. What
came before anybody asked, and what is stale when time is short, is dropped for the newest. What the device says besides
frames becomes events of the next one.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Final

from eitskin.acquisition.afterwards import Afterwards
from eitskin.acquisition.device import Device
from eitskin.errors import NotReady, PortReturned
from eitskin.pipeline.first_frame import FirstFrame
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin_proto.wire.answers import Event
from eitskin_proto.wire.codes import EventCode, MessageType
from eitskin_proto.wire.frames import FRAME_TYPE

LEISURE_S: Final = 0.001
"""The line rests if nothing comes for so long; what was published has been handed over by then."""

MOST_FRUITLESS: Final = 5
"""How often a device is greeted anew without a single frame of its configuration in between."""

FIRST_AGAIN_S: Final = 0.1
"""After which a device is greeted a second time that sends frames of another generation; doubles up to a second."""

FIRST_BAD_S: Final = 5.0
"""A device is greeted anew, so that it starts anew, if its frames come and none can be used for so long ..."""

LONGEST_BAD_S: Final = 60.0
"""... and again after twice as long, up to this."""

LOOK_NS: Final = 50_000_000
"""Without a frame that can be used for so long, it is looked at what the matter is."""

MOST_EVENTS: Final = 8
"""Events that one frame tells at most if it is to tell those of a device's own words, too."""

MOST_AT_ONCE: Final = 64
"""Payloads of which the newest is looked for; a device faster than this loop has its rest dropped next time."""


class FrameSource:
    """Reads a device and lets a pipeline accept its frames.

    Args:
        device: It answered the handshake.
        pipeline: Made for it.
        done: Told when ``afterwards`` were done: when they began and ended, on ``perf_counter_ns``.
    """

    def __init__(self, device: Device, pipeline: Pipeline, done: Callable[[int, int], None] | None = None) -> None:
        self._device, self._pipeline = device, pipeline
        self.afterwards = Afterwards(done)
        """What is left to do of the frame that was yielded last; done while the line rests, or before the next one."""
        self.recoveries = 0
        """How often the device was greeted anew after silence, a reset, or frames that could not be used."""
        self._stopping = self._started = self._reading = self._failed = False
        self._fruitless = 0
        self._fit_ns = self._greeted_ns = self._patient_ns = self._looked_ns = time.perf_counter_ns()
        self._withheld = 0
        self._bad_s = FIRST_BAD_S
        self.payload = b""
        """Of the frame in hand."""
        self.tell_withheld: Callable[[bytes, int], None] | None = None
        """Takes the payload of each frame that is not accepted, and when it was read."""

    @property
    def stopping(self) -> bool:
        """Whether the loop is to end; setting it ends the waiting for answers as well."""
        return self._stopping

    @stopping.setter
    def stopping(self, value: bool) -> None:
        self._stopping = self._device.stopping = value

    @property
    def trouble(self) -> str:
        """Why no frame that can be used has come for ``silence_s`` / 2; "" while they come, or nobody asks for them.

        ``silent``, ``front_end_failed`` or one of :data:`eitskin.pipeline.intake.REASONS`; from any thread.
        """
        quiet_s = (time.perf_counter_ns() - self._fit_ns) * 1e-9
        if not self._reading or quiet_s < self._device.silence_s / 2.0:
            return ""
        if self._failed:
            return "front_end_failed"
        intake = self._pipeline.intake
        return intake.last_reason if intake.withheld_total > self._withheld else "silent"

    def accepted(self, until_ns: int | None) -> Iterator[None]:
        """Yield whenever the pipeline has accepted a frame.

        What came before anybody asked is left out: a robot's first frame must not be an old one.

        Args:
            until_ns: When to end, on ``perf_counter_ns``; None goes on until ``stopping``.

        Raises:
            PortLost: The port vanished.
            NotReady: The device fell silent and does not answer, or sends no frames of its configuration.
            HandshakeError: It came back as another one.
        """
        device, pipeline = self._device, self._pipeline
        intake = pipeline.intake
        try:
            self._start()
        except NotReady:
            if self._stopping:
                return
            raise
        intake.heard_ns = self._fit_ns = self._patient_ns = time.perf_counter_ns()
        first = FirstFrame(pipeline.clock, self._fit_ns)
        self._withheld = intake.withheld_total
        self._reading = True
        try:
            while not self._stopping:
                wait_s = self._wait_s(until_ns)
                if wait_s <= 0:
                    return
                try:
                    payloads = self._payloads(wait_s)
                    if payloads and (first.backlog or pipeline.budget.drops_stale):
                        payloads, first.backlog = self._newest(payloads), False
                except PortReturned:
                    self._patient_ns = time.perf_counter_ns()
                    self._recover()
                    continue
                read_ns = device.read_ns
                held = device.held
                held.extend(payloads)
                while held:  # what is left when the caller stops asking comes again the next time
                    payload = held.popleft()
                    if payload[0] != FRAME_TYPE:
                        self._take_note(payload)
                    elif self._accept(payload, read_ns, first):
                        withheld = intake.withheld_total
                        self._reading = False
                        yield
                        self._reading = True
                        intake.heard_ns = now_ns = time.perf_counter_ns()  # however long it took is no silence
                        if intake.withheld_total == withheld:  # whoever asked could use it
                            self._fit_ns, self._withheld = now_ns, withheld
                        if self._stopping:
                            return
                if intake.generation_differs or read_ns - self._fit_ns >= LOOK_NS:
                    self._look_after(read_ns)
        finally:
            self._reading = False

    def _wait_s(self, until_ns: int | None) -> float:
        """Return how long to wait for bytes; 0 or less if the time is over."""
        silence_s = self._device.silence_s
        return silence_s if until_ns is None else min(silence_s, (until_ns - time.perf_counter_ns()) * 1e-9)

    def _look_after(self, now_ns: int) -> None:
        """Greet the device anew if no frame that can be used came for too long."""
        intake, silence_ns = self._pipeline.intake, self._device.silence_s * 1e9
        if self._fit_ns != self._looked_ns:  # a frame came that could be used, since the last look
            self._looked_ns, self._fruitless, self._failed, self._bad_s = self._fit_ns, 0, False, FIRST_BAD_S
        since_ns = now_ns - max(self._greeted_ns, self._fit_ns)
        quiet_ns = now_ns - max(self._greeted_ns, intake.heard_ns)
        if self._stopping:
            return
        if intake.generation_differs:
            again_s = min(FIRST_AGAIN_S * 2 ** min(self._fruitless, 4), 1.0)
            if not self._fruitless or now_ns - self._greeted_ns >= 1e9 * again_s:
                self._recover()
        elif quiet_ns >= silence_ns:
            if quiet_ns >= silence_ns + 1e9 * self._device.pause_s:
                self._recover()
        elif since_ns >= 1e9 * max(self._bad_s, self._device.silence_s):  # frames come, and none can be used
            self._bad_s = min(2.0 * self._bad_s, LONGEST_BAD_S)
            self._fruitless = 0
            self._recover()

    def _payloads(self, wait_s: float) -> list[bytes]:
        """Return what comes, waiting for it; if nothing comes for a moment, do what can wait, and wait on."""
        if payloads := self.afterwards.payloads(self._device):
            return payloads
        if self._pipeline.has_leisure_work:
            if payloads := self._device.payloads(LEISURE_S):
                return payloads
            self._pipeline.look_at_health()
        return [] if self._stopping else self._device.payloads(wait_s)  # what woke the moment's wait wakes no other

    def _start(self) -> None:
        """Start the stream with the first frame that is asked for: what nobody reads would only grow old."""
        if self._started:
            return
        try:
            self._device.start()
            self._pipeline.clock.anchor(self._device.time_sample)
        except PortReturned:
            self._patient_ns = time.perf_counter_ns()
            self._recover()
        self._started = True

    def _newest(self, payloads: list[bytes]) -> list[bytes]:
        """Return what to compute when time is short: of all frames that wait, the newest, if there is any."""
        while more := self._device.payloads(0.0):
            payloads += more
            if len(payloads) > MOST_AT_ONCE:
                break
        newest: list[bytes] = []
        for payload in payloads:
            if payload[0] != FRAME_TYPE:
                self._take_note(payload)
                continue
            for stale in newest:
                self._pipeline.intake.discard(stale)
                self._tell_of(stale, self._device.read_ns)
            newest = [payload]
        return newest

    def _accept(self, payload: bytes, read_ns: int, first: FirstFrame) -> bool:
        """Return whether a frame is accepted."""
        self.afterwards.do()
        accepted = self._pipeline.accept(payload, read_ns)
        if accepted and first.is_old(self._pipeline.record.scanned_ns, read_ns):
            accepted = self._pipeline.intake.give_up("stale")
        if not accepted:
            self._tell_of(payload, read_ns)
            return False
        self.payload = payload
        return True

    def _tell_of(self, withheld: bytes, read_ns: int) -> None:
        if self.tell_withheld is not None:
            self.tell_withheld(withheld, read_ns)

    def _recover(self) -> None:
        """Greet the device anew, and let it start anew.

        Raises:
            NotReady: It does not answer, or was greeted ``MOST_FRUITLESS`` times for nothing, and nobody waits longer.
            HandshakeError: It is another device, or measures in another way.
            PortLost: The port is gone.
        """
        if self._fruitless >= MOST_FRUITLESS:
            self._bear(NotReady(self._fruitless_text()))
        self._fruitless += 1
        while True:
            try:
                self._device.recover()
                break
            except PortReturned:
                self._patient_ns = time.perf_counter_ns()
                continue  # it vanished once more while it was greeted
            except NotReady as error:
                if self._stopping:
                    return
                self._bear(error)
        self.recoveries += 1
        self._pipeline.greet(self._device.hello)
        self._pipeline.clock.anchor(self._device.time_sample)
        self._pipeline.intake.tell_next("recovered")
        self._greeted_ns = time.perf_counter_ns()

    def _bear(self, error: NotReady) -> None:
        """Open the line anew for a device that hangs, as long as somebody wants to wait for it; else raise.

        Raises:
            NotReady: Nobody waits, or not any longer.
        """
        patience_s = self._device.patience_s
        last_ns = max(self._pipeline.intake.heard_ns, self._patient_ns)
        if (time.perf_counter_ns() - last_ns) * 1e-9 >= patience_s:
            if patience_s > 0:
                raise NotReady(f"no frame within {patience_s:g} s of --reconnect: {error}") from error
            raise error
        with suppress(PortReturned):
            self._device.reopen()

    def _fruitless_text(self) -> str:
        name, intake = self._device.transport.name, self._pipeline.intake
        if self._failed:
            sent = "only FRONT_END_FAILED: its front end does not answer"
        elif intake.generation_differs:
            sent = f"frames of another generation than {intake.generation}, which it says that it runs"
        elif intake.withheld_total > self._withheld:
            sent = f"frames that are withheld as {intake.last_reason}"
        else:
            sent = "no frame"
        return (
            f"{name} answers and acknowledges START, but sent {sent} after {MOST_FRUITLESS} attempts: power the device "
            "off and on; if that does not help, flash it"
        )

    def _take_note(self, payload: bytes) -> None:
        if payload[0] != MessageType.EVENT or len(payload) != Event.LAYOUT.size:
            return
        event = Event.unpack(payload)
        self._failed |= event.code == EventCode.FRONT_END_FAILED
        self._pipeline.intake.tell_next(f"device:{event.text.lower()}", MOST_EVENTS)
