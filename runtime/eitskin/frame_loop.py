"""The order of a frame's way, from the line to whoever takes it.

::

    read -> accept -> capture -> compute -> mode -> pack -> publish -> finish -> tell, while the line rests
     ^       |  withheld                |  withheld
     |<------+--------------------------+            and on with the next

The loop blocks in the transport's ``read`` and nowhere else; silence and resets are the business of
:mod:`eitskin.frame_source`. Each step is somebody else's: the source reads, the pipeline accepts and computes, messages
are packed and handed to a taker, and then streams are told what was measured. Between them goes one
:class:`eitskin.messaging.frame_record.FrameRecord`.
"""

import threading
import time
from collections.abc import Callable, Generator, Iterator
from typing import Any, Final, Protocol

from eitskin.acquisition.device import Device
from eitskin.errors import BadReference, HandshakeError, SkinError, TransportError
from eitskin.frame_source import FrameSource
from eitskin.messaging.frame_message import Asked, FrameMessages
from eitskin.messaging.frame_record import INFER, PACK, PUBLISH, READ, FrameRecord
from eitskin.messaging.streams.teller import Teller, begin
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.pipeline.idle import IdleMode
from eitskin.pipeline.stats import Statistics
from eitskin.reference.builder import ReferenceBuilder
from eitskin.reference.captured import Reference
from eitskin.reference.judged import Yardstick, yardstick_of
from eitskin.reference.recapture import Recapture
from eitskin.touches.watch import TouchWatch

CAPTURE_S: Final = 30.0
"""How long capturing a reference may take before it is given up, beyond what its frames take."""

PLAIN: Final = Asked()
"""Frames, and no touches."""


class Taker(Protocol):
    """Who takes the messages of frames: a publisher, or this process.

    One may also have ``asked``, an :class:`eitskin.messaging.frame_message.Asked`; one without takes frames, and no
    touches. One may have ``streams`` (:mod:`eitskin.messaging.streams.teller`).
    """

    @property
    def wanted(self) -> bool:
        """Whether anybody takes frames; otherwise they are neither computed nor packed."""

    @property
    def short(self) -> bool:
        """Whether the next message may go without a map that has not changed."""

    def send(self, message: memoryview) -> None:
        """Take one message, whose memory the next one overwrites."""


class FrameLoop:
    """Takes frames from a device through a pipeline to whoever takes them.

    Args:
        device: It answered the handshake.
        pipeline: Made for it.
        idle: When to ask the device for which mode; None leaves it scanning.
    """

    def __init__(self, device: Device, pipeline: Pipeline, idle: IdleMode | None) -> None:
        self._device, self._pipeline, self.idle = device, pipeline, idle
        shape = pipeline.bundle.skin.grid.shape
        self._messages = FrameMessages(device.configuration, pipeline.bundle.id, device.hello.serial_number, shape)
        self._touches: TouchWatch | None = None
        self.statistics = Statistics()
        self.source = FrameSource(device, pipeline, self.statistics.told)
        self.reference: Reference | None = None
        self._recapture: Recapture | None = None
        self._capturing = threading.Lock()
        self.teller: Teller | None = None
        """Of what was measured, where a taker has streams."""
        self.verifier_status: Callable[[], dict[str, Any]] = dict
        """What who verifies frames says of itself; from any thread. Nothing where nobody does."""

    @property
    def run_id(self) -> str:
        """Differs after each start; ``run`` of every message."""
        return self._messages.run

    @property
    def published(self) -> int:
        """Frames packed so far."""
        return self._messages.published

    def run(self, taker: Taker, until_ns: int | None = None) -> Generator[FrameRecord, None, None]:
        """Take frames through, and yield each one's record when it is done; the next frame overwrites it.

        Args:
            taker: Who takes their messages.
            until_ns: When to end, on ``perf_counter_ns``; None goes on until ``stop``.

        Raises:
            BadReference: There is no reference yet.
            PortLost: The port vanished.
            HandshakeError: The device fell silent and does not answer, or came back as another one.
        """
        if self.reference is None:
            raise BadReference(
                "there is no reference: call capture_reference() with the sheet flat and untouched, or open the skin "
                "with reference=FILE"
            )
        pipeline, record = self._pipeline, self._pipeline.record
        streams, teller = begin(self.teller, taker, self._messages.run)
        self.source.tell_withheld = teller.withheld
        try:
            for _ in self._accepted(until_ns):
                recapture = self._recapture
                if recapture is not None and not (record.idle or recapture.settled):
                    self._feed(recapture)
                wanted = taker.wanted
                if pipeline.compute(wanted):
                    self._choose_mode(whole=recapture is not None)
                    asked, first, number = streams.asked, streams.first, self.published + 1 if wanted else None
                    if asked and first:
                        teller.frame(self.source.payload, number)
                    if wanted:
                        self._hand_over(taker)
                    else:
                        record.stamps[PACK] = record.stamps[INFER]
                    record.stamps[PUBLISH] = time.perf_counter_ns()
                    self._finish(teller if asked and not first else None, number)
                    yield record
                    self.statistics.ready(time.perf_counter_ns())
                elif streams.asked:
                    teller.withheld(self.source.payload, record.stamps[READ])
        finally:
            self.source.afterwards.do()
            self._give_up_recapture("the stream ended")

    def _accepted(self, until_ns: int | None) -> Iterator[None]:
        """Yield whenever a frame was accepted; what a device that is greeted just now fails at matters no more."""
        try:
            yield from self.source.accepted(until_ns)
        except (HandshakeError, TransportError):
            if not self.source.stopping:
                raise

    def stop(self) -> None:
        """End soon, whatever is waited for; may be called from any thread and from a signal handler."""
        self.source.stopping = True
        self._give_up_recapture("stopped")
        self._device.transport.cancel()

    def _give_up_recapture(self, why: str) -> None:
        recapture = self._recapture
        if recapture is not None:
            recapture.settle(BadReference(f"{why} while the reference was captured; the old one stays"))

    def _choose_mode(self, *, whole: bool) -> None:
        """Ask the device for whole scans, or for those of a few drives, if this frame is a reason to."""
        if self.idle is not None:
            record, health = self._pipeline.record, self._pipeline.health
            lacking = health is not None and health.electrodes.missing.any()
            touched = whole or record.touched or bool(lacking)  # the idle gate knows no missing rows
            mode = self.idle.step(record.stamps[READ], touched=touched, idle=record.idle)
            if mode is not None:
                self._device.ask_mode(mode)

    def _hand_over(self, taker: Taker) -> None:
        """Give the taker what it asks for."""
        asked: Asked = getattr(taker, "asked", PLAIN)
        if asked.touches or self._pipeline.record.touches is not None:
            self._look_for_touches(wanted=asked.touches)
        message = self._pack(short=taker.short, frames=asked.frames)
        if asked.alone:
            taker.send(memoryview(self._messages.touch_message()))
        if asked.frames:
            taker.send(message)

    def _look_for_touches(self, *, wanted: bool) -> None:
        """Put the touches into the record, or forget them when nobody asks any more."""
        pipeline, record, touches = self._pipeline, self._pipeline.record, self._touches
        if touches is None:
            self._touches = touches = TouchWatch(pipeline.bundle.skin.grid)
        if not wanted:
            touches.forget()
            record.touches = None
            return
        values = pipeline.buffers.map[0] if record.touched and not record.map_is_zero else None
        which = record.solver, record.map_key
        record.touches = touches.look(values, which, pipeline.buffers.surface, record.device_us)

    def _pack(self, *, short: bool, frames: bool) -> memoryview:
        record = self._pipeline.record
        self._messages.begin(record, short=short, frames=frames)
        self._pipeline.judge(record.stamps[PACK])
        record.corrupt = self._device.deframer.corrupt
        return self._messages.finish(record)

    def _finish(self, teller: Teller | None, number: int | None) -> None:
        """Take note of the frame, after it was handed over; what it was computed under is told before that changes."""
        record = self._pipeline.record
        self.statistics.add(record.stamps, record.solver, record.touched, record.skipped, record.events)
        if teller is None:
            self._pipeline.note_health()
        else:
            self.source.afterwards.put(self._pipeline.note_health, teller.frame, self.source.payload, number)

    def use(self, found: Reference, *, fresh: bool = False) -> None:
        """Normalise against a reference from the next frame on; before the loop runs, or in its thread.

        Args:
            found: The reference.
            fresh: It was taken of the sheet as it is now, not read from a file.
        """
        self._pipeline.use_reference(found, fresh=fresh)
        self.reference = found

    def capture(self, frames: int, *, force: bool = False) -> Reference:
        """Use the mean of the next frames as the reference, and return it; the loop must not run.

        Args:
            frames: How many.
            force: Take it even if the sheet was bent, touched or moving (:mod:`eitskin.reference.judged`).

        Raises:
            BadReference: The sheet was bent, touched or moving, or nothing is connected, or the frames did not come.
            PortLost: The port vanished.
            ValueError: Fewer than 2 frames.
        """
        builder, yardstick = ReferenceBuilder(frames, self._pipeline.skin), self._yardstick()
        asked_ns, first = time.perf_counter_ns(), True
        for _ in self._accepted(asked_ns + int(self._patience_s(frames) * 1e9)):
            # The newest frame that waited may be the first to be accepted; a reference is of the sheet as it is now.
            before, first = first and self._pipeline.record.scanned_ns < asked_ns, False
            if before:
                continue
            if unfit := self._unfit_for_reference():
                builder.leave_out(unfit)
            elif builder.add(self._pipeline.normaliser.voltages()):
                found = builder.finish(self._device.hello, yardstick, force=force)
                self.use(found, fresh=True)
                return found
        if self.source.stopping:
            raise BadReference("stopped while the reference was captured")
        raise BadReference(f"only {builder.taken} of {frames} frames for the reference came; is the device streaming?")

    def recapture(self, frames: int, *, force: bool = False) -> Reference:
        """Capture a new reference while the loop runs, from another thread.

        Args:
            frames: How many.
            force: As in :meth:`capture`.

        Raises:
            BadReference: As in :meth:`capture`; or the loop was stopped, or another one is being captured. The old
                reference stays.
        """
        recapture = Recapture(ReferenceBuilder(frames, self._pipeline.skin), self._yardstick(), force=force)
        with self._capturing:
            if self._recapture is not None:
                raise self._recapture.under_way()
            self._recapture = recapture
        if self.source.stopping:  # looked at behind the line above, which ``stop`` looks at behind its own
            self._give_up_recapture("stopped")
        try:
            found = recapture.wait(self._patience_s(frames))
        finally:
            self._recapture = None
        if found is None:
            raise recapture.too_few()
        return found

    def _yardstick(self) -> Yardstick:
        health = self._pipeline.health
        missing = None if health is None else health.electrodes.missing.copy()
        return yardstick_of(self._pipeline.bundle, self.reference, missing)

    def _patience_s(self, frames: int) -> float:
        return CAPTURE_S + frames / max(self._device.hello.rate_mHz / 1000, 1e-3)

    def _unfit_for_reference(self) -> str:
        """Return why the frame in hand is not one of a reference, or ""."""
        if "saturated" in self._pipeline.record.events:
            return "rows are cut off"
        return self._pipeline.front_end.look(self._pipeline.normaliser)

    def _feed(self, recapture: Recapture) -> None:
        try:
            if unfit := self._unfit_for_reference():
                recapture.builder.leave_out(unfit)
                return
            if not recapture.builder.add(self._pipeline.normaliser.voltages()):
                return
        except BadReference as error:
            recapture.settle(error)
            return
        try:
            found = recapture.finish(self._device.hello)
            self.use(found, fresh=True)
            self._pipeline.record.note("reference")
        except SkinError as error:
            recapture.settle(error)
        else:
            recapture.settle(found)
