"""The loop that takes a frame from the device to its subscribers: reading, order of steps, silence and recovery.

::

    read -> accept -> capture -> compute -> mode -> pack -> publish -> finish -> streams, while the line rests
     ^       |  withheld                |  withheld
     |<------+--------------------------+            and on with the next

:class:`FrameLoop` owns this order. The pipeline accepts and computes a frame; the packer packs its message and hands it
over; then the streams send the measurements. One :class:`eitskin.frame_record.FrameRecord` passes between them.

:class:`FrameSource` blocks in the transport's ``read``, and nothing else blocks. After silence, a reset, or when the
port has returned, it repeats the handshake. A device is silent if no frame of its configuration arrives, whatever else
does. If its frames are unusable, the source restarts its stream too. Frames from before the first subscription are
dropped for the newest one, and so are stale ones when time is short. Events of the device go out with the next frame.

:class:`DeferredWork` waits until the line rests: a frame's message wakes a subscriber, which needs a core at that
moment. Arriving bytes end the wait, so that no frame waits for deferred work.
"""

import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from typing import Any, Final, Protocol

from eitskin.acquisition.device import Device
from eitskin.errors import BadReference, HandshakeError, NotReady, PortReturned, SkinError, TransportError
from eitskin.frame_record import INFER, PACK, PUBLISH, READ, FrameRecord
from eitskin.messaging.frame_message import Demand, FrameMessages
from eitskin.messaging.streams.publisher import StreamFeed
from eitskin.model.taught import TaughtFinder
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.pipeline.idle import IdleMode
from eitskin.pipeline.stats import Statistics
from eitskin.reference.builder import ReferenceBuilder
from eitskin.reference.captured import Reference
from eitskin.reference.judged import ReferenceChecks, reference_checks
from eitskin.reference.recapture import Recapture
from eitskin.touches.watch import TouchWatch
from eitskin_proto.wire.codes import EventCode, MessageType
from eitskin_proto.wire.messages import Event
from eitskin_proto.wire.volts import SCANS, is_signed

GIVE_WAY_S: Final = 0.001
"""The least that ports wait, which count in milliseconds; several times what a subscriber takes to have its frame."""


class DeferredWork:
    """Keeps the remaining work of one frame.

    Args:
        done: Called with its begin and end, on ``perf_counter_ns``; None for no call.
    """

    __slots__ = ("_arguments", "_done", "_then", "_work")

    def __init__(self, done: Callable[[int, int], None] | None) -> None:
        self._done = done
        self._work: Callable[..., None] | None = None
        self._then: Callable[[], None] | None = None
        self._arguments: tuple[Any, ...] = ()

    def put(self, then: Callable[[], None], work: Callable[..., None], *arguments: Any) -> None:
        """Keep deferred work; earlier work is done already.

        Args:
            then: Work that must not be done before it.
            work: The deferred work, which is timed.
            arguments: Of it.
        """
        self._then, self._work, self._arguments = then, work, arguments

    def do(self) -> None:
        """Do the deferred work now."""
        work, self._work = self._work, None
        if work is not None:
            begin_ns = time.perf_counter_ns()
            work(*self._arguments)
            if self._done is not None:
                self._done(begin_ns, time.perf_counter_ns())
            if self._then is not None:
                self._then()

    def payloads(self, device: Device) -> list[bytes]:
        """Wait briefly for the line, do the deferred work, and return the payloads that came; at once without work.

        Raises:
            PortLost: The line is gone.
        """
        if self._work is None:
            return []
        try:
            return device.payloads(GIVE_WAY_S)
        finally:
            self.do()


LINE_REST_S: Final = 0.001
"""The line rests if nothing comes for this long; the published frame has been handed over by then."""

MAX_GREETINGS: Final = 5
"""Most handshakes in a row without a frame of the device's configuration in between."""

AGAIN_S: Final = 1.0
"""After which a device is greeted once more that goes on sending frames of another generation."""

BAD_S: Final = 5.0
"""The handshake is repeated, which restarts the stream, whenever all frames have been unusable for this long."""

LOOK_NS: Final = 50_000_000
"""Without a usable frame for this long, the cause is examined."""

WAKE_S: Final = 1e-6
"""Of a look at the line without waiting."""

MOST_EVENTS: Final = 8
"""Events that one frame tells at most if it is to tell those of a device's own words, too."""

MOST_AT_ONCE: Final = 64
"""Payloads of which the newest is looked for; a device faster than this loop has its rest dropped next time."""


class FrameSource:
    """Reads a device and lets a pipeline accept its frames.

    Args:
        device: It answered the handshake.
        pipeline: Made for it.
        done: Called after ``deferred`` with its begin and end, on ``perf_counter_ns``.
    """

    def __init__(self, device: Device, pipeline: Pipeline, done: Callable[[int, int], None] | None = None) -> None:
        self._device, self._pipeline = device, pipeline
        self.deferred = DeferredWork(done)
        """Remaining work of the frame yielded last; done while the line rests, or before the next one."""
        self.recoveries = 0
        """Handshakes repeated after silence, a reset, or unusable frames."""
        self._stopping = self._started = self._reading = self._failed = False
        self._fruitless = 0
        self._fit_ns = self._greeted_ns = self._patient_ns = self._looked_ns = time.perf_counter_ns()
        self._withheld = 0
        self.payload = b""
        """Of the frame in hand."""
        self.waits = True
        """Whether it waits for frames; else it ends once none is left, as where a program feeds them."""
        self.on_withheld: Callable[[bytes, int], None] | None = None
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
        """Why no usable frame has come for ``silence_s`` / 2; "" while they come, or while there is no subscriber.

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

        Discard frames from before the first request: a robot's first frame must not be an old one. An unread line fills
        up with the oldest frames, so waiting frames are old until it has been read empty.

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
            self.begin()
        except NotReady:
            if self._stopping:
                return
            raise
        intake.heard_ns = self._fit_ns = self._patient_ns = time.perf_counter_ns()
        backlog = self.waits  # else the program that feeds frames decides
        self._withheld = intake.withheld_total
        self._reading = True
        try:
            while not self._stopping:
                wait_s = self._wait_s(until_ns)
                if wait_s <= 0:
                    return
                try:
                    payloads = self._payloads(wait_s)
                    if payloads and (backlog or pipeline.budget.drops_stale):
                        payloads, backlog = self._newest(payloads), False
                except PortReturned:
                    self._patient_ns = time.perf_counter_ns()
                    self._recover()
                    continue
                read_ns = device.read_ns
                held = device.held
                held.extend(payloads)
                while held:  # what is left when the caller stops asking comes again the next time
                    payload = held.popleft()
                    if payload[0] not in SCANS:
                        self._take_note(payload)
                    elif self._accept(payload, read_ns):
                        withheld = intake.withheld_total
                        self._reading = False
                        yield
                        self._reading = True
                        intake.heard_ns = now_ns = time.perf_counter_ns()  # however long it took is no silence
                        if intake.withheld_total == withheld:  # the taker could use it
                            self._fit_ns, self._withheld = now_ns, withheld
                        if self._stopping:
                            return
                if not self.waits:
                    return
                if intake.generation_differs or read_ns - self._fit_ns >= LOOK_NS:
                    self._look_after(read_ns)
        finally:
            self._reading = False

    def _wait_s(self, until_ns: int | None) -> float:
        """Return how long to wait for bytes; 0 or less if the time is over."""
        silence_s = self._device.silence_s if self.waits else WAKE_S
        return silence_s if until_ns is None else min(silence_s, (until_ns - time.perf_counter_ns()) * 1e-9)

    def _look_after(self, now_ns: int) -> None:
        """Repeat the handshake if no usable frame came for too long."""
        intake, silence_ns = self._pipeline.intake, self._device.silence_s * 1e9
        if self._fit_ns != self._looked_ns:  # a frame came that could be used, since the last look
            self._looked_ns, self._fruitless, self._failed = self._fit_ns, 0, False
        since_ns = now_ns - max(self._greeted_ns, self._fit_ns)
        quiet_ns = now_ns - max(self._greeted_ns, intake.heard_ns)
        if self._stopping:
            return
        if intake.generation_differs:
            if not self._fruitless or now_ns - self._greeted_ns >= 1e9 * AGAIN_S:
                self._recover()
        elif quiet_ns >= silence_ns:
            if quiet_ns >= silence_ns + 1e9 * self._device.pause_s:
                self._recover()
        elif since_ns >= 1e9 * max(BAD_S, self._device.silence_s):  # frames come, and none can be used
            self._fruitless = 0
            self._recover()

    def _payloads(self, wait_s: float) -> list[bytes]:
        """Wait for bytes and return them; if none come for a moment, do the deferred work and wait on."""
        if payloads := self.deferred.payloads(self._device):
            return payloads
        if self._pipeline.has_leisure_work:
            if payloads := self._device.payloads(LINE_REST_S):
                return payloads
            self._pipeline.check_health()
        return [] if self._stopping else self._device.payloads(wait_s)  # what woke the moment's wait wakes no other

    def begin(self) -> None:
        """Start the stream with the first request for frames; earlier frames would only grow old."""
        if self._started:
            return
        self._patient_ns = time.perf_counter_ns()
        try:
            self._device.start()
            self._pipeline.clock.anchor(self._device.time_sample)
        except PortReturned:
            self._recover()
        except NotReady as error:
            self._bear(error)
            self._recover()
        self._started = True

    def _newest(self, payloads: list[bytes]) -> list[bytes]:
        """Return the newest waiting frame, if any, to compute when time is short."""
        while more := self._device.payloads(0.0):
            payloads += more
            if len(payloads) > MOST_AT_ONCE:
                break
        newest: list[bytes] = []
        for payload in payloads:
            if payload[0] not in SCANS:
                self._take_note(payload)
                continue
            for stale in newest:
                self._pipeline.intake.discard(stale)
                self._report_withheld(stale, self._device.read_ns)
            newest = [payload]
        return newest

    def _accept(self, payload: bytes, read_ns: int) -> bool:
        """Return whether a frame is accepted."""
        self.deferred.do()
        if not self._pipeline.accept(payload, read_ns):
            self._report_withheld(payload, read_ns)
            return False
        self.payload = payload
        return True

    def _report_withheld(self, withheld: bytes, read_ns: int) -> None:
        if self.on_withheld is not None:
            self.on_withheld(withheld, read_ns)

    def _recover(self) -> None:
        """Repeat the handshake and restart the stream.

        Raises:
            NotReady: It does not answer, or ``MAX_GREETINGS`` handshakes brought no frame, and the time to wait is
                over.
            HandshakeError: It is another device, or measures in another way.
            PortLost: The port is gone.
        """
        if self._fruitless >= MAX_GREETINGS:
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
        self._pipeline.intake.add_event("recovered")
        self._greeted_ns = time.perf_counter_ns()

    def _bear(self, error: NotReady) -> None:
        """Open the line again for a hung device while there is time to wait; else raise.

        Raises:
            NotReady: The time to wait is over.
        """
        with suppress(PortReturned):
            self._device.bear(error, max(self._pipeline.intake.heard_ns, self._patient_ns))

    def _fruitless_text(self) -> str:
        name, intake = self._device.transport.name, self._pipeline.intake
        if self._failed:
            sent = "only FRONT_END_FAILED: its front end does not answer"
        elif intake.generation_differs:
            sent = f"frames of another generation than {intake.generation}, which it reports"
        elif intake.withheld_total > self._withheld:
            sent = f"frames that are withheld as {intake.last_reason}"
        else:
            sent = "no frame"
        return (
            f"{name} answers and acknowledges START, but sent {sent} after {MAX_GREETINGS} attempts: power the device "
            "off and on; if that does not help, flash it"
        )

    def _take_note(self, payload: bytes) -> None:
        if payload[0] != MessageType.EVENT or len(payload) != Event.LAYOUT.size:
            return
        event = Event.unpack(payload)
        self._failed |= event.code == EventCode.FRONT_END_FAILED
        self._pipeline.intake.add_event(f"device:{event.text.lower()}", MOST_EVENTS)


CAPTURE_S: Final = 30.0
"""Longest time to capture a reference, beyond the time of its frames."""

FRAMES_ONLY: Final = Demand()
"""Frames, and no touches."""


class Taker(Protocol):
    """A consumer of frame messages: a publisher, or this process.

    It may have ``asked``, an :class:`eitskin.messaging.frame_message.Demand`; without it, it takes frames and no
    touches. It may have ``streams`` (:mod:`eitskin.messaging.streams.publisher`).
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
    """Takes frames from a device through a pipeline to a taker.

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
        self.feed: StreamFeed | None = None
        """The streams of measurements, if the taker has them."""
        self.verifier_status: Callable[[], dict[str, Any]] = dict
        """The verifier's status; empty without a verifier; from any thread."""

    @property
    def run_id(self) -> str:
        """Differs after each start; ``run`` of every message."""
        return self._messages.run

    @property
    def published(self) -> int:
        """Frames packed so far."""
        return self._messages.published

    def run(self, taker: Taker, until_ns: int | None = None) -> Generator[FrameRecord, None, None]:
        """Process frames, and yield each one's record when it is done; the next frame overwrites it.

        Args:
            taker: The consumer of their messages.
            until_ns: When to end, on ``perf_counter_ns``; None goes on until ``stop``.

        Raises:
            BadReference: There is no reference yet.
            PortLost: The port vanished.
            HandshakeError: The device fell silent and does not answer, or came back as another one.
        """
        if self.reference is None:
            raise BadReference(
                "found no reference: call capture_reference() while the sheet lies flat and untouched, or open the "
                "skin with reference=FILE"
            )
        pipeline, record = self._pipeline, self._pipeline.record
        streams, feed = getattr(taker, "streams", None), self.feed
        if feed is None or streams is None:
            feed = None
        else:
            feed.begin(streams, self._messages.run)
        self.source.on_withheld = None if feed is None else feed.withheld
        try:
            for _ in self._accepted(until_ns):
                recapture = self._recapture
                if recapture is not None and not (record.idle or recapture.settled):
                    self._feed(recapture)
                wanted = taker.wanted
                if pipeline.compute(wanted):
                    self._choose_mode(whole=recapture is not None)
                    number = self.published + 1 if wanted else None
                    if wanted:
                        self._hand_over(taker)
                    else:
                        record.stamps[PACK] = record.stamps[INFER]
                    record.stamps[PUBLISH] = time.perf_counter_ns()
                    self._finish(feed if feed is not None and feed.asked else None, number)
                    yield record
                    self.statistics.ready(time.perf_counter_ns())
                elif feed is not None:
                    feed.withheld(self.source.payload, record.stamps[READ])
        finally:
            self.source.deferred.do()
            self._give_up_recapture("the stream ended")

    def _accepted(self, until_ns: int | None) -> Iterator[None]:
        """Yield whenever a frame was accepted; ignore errors of the device once stopping."""
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
            recapture.settle(BadReference(f"{why} while capturing the reference; the old one stays"))

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
        """Hand the taker the messages that it requests."""
        asked: Demand = getattr(taker, "asked", FRAMES_ONLY)
        if asked.touches or self._pipeline.record.touches is not None:
            self._look_for_touches(wanted=asked.touches)
        message = self._pack(short=taker.short, frames=asked.frames)
        if asked.alone:
            taker.send(memoryview(self._messages.touch_message()))
        if asked.frames:
            taker.send(message)

    def _look_for_touches(self, *, wanted: bool) -> None:
        """Put the touches into the record, or forget them once there is no request for touches."""
        pipeline, record, touches = self._pipeline, self._pipeline.record, self._touches
        if touches is None:
            grid, field = pipeline.bundle.skin.grid, pipeline.field
            finder = None if field is None else TaughtFinder(field, grid)
            self._touches = touches = TouchWatch(grid, finder, pipeline.bundle.touch_kind)
        if not wanted:
            touches.reset()
            record.touches, pipeline.maps.stillness.alone = None, False
            return
        values = pipeline.buffers.map[0] if record.touched and not record.map_is_zero else None
        which = record.solver, record.map_key
        record.touches = touches.update(values, which, pipeline.buffers.surface, record.device_us, record.fused)
        pipeline.maps.stillness.alone = touches.tracker.moves

    def _pack(self, *, short: bool, frames: bool) -> memoryview:
        record = self._pipeline.record
        self._messages.begin(record, short=short, frames=frames)
        self._pipeline.judge(record.stamps[PACK])
        record.corrupt = self._device.deframer.corrupt
        return self._messages.finish(record)

    def _finish(self, feed: StreamFeed | None, number: int | None) -> None:
        """Record the frame after it was handed over, and send its conditions before they change."""
        record = self._pipeline.record
        self.statistics.add(record.stamps, record.solver, record.touched, record.skipped, record.events)
        if feed is None:
            self._pipeline.keep_for_health()
        else:
            self.source.deferred.put(self._pipeline.keep_for_health, feed.frame, self.source.payload, number)

    def use_reference(self, found: Reference, *, fresh: bool = False) -> None:
        """Normalise against a reference from the next frame on; before the loop runs, or in its thread.

        Args:
            found: The reference.
            fresh: It was taken of the sheet as it is now, not read from a file.

        Raises:
            MismatchError: It lacks rows that the bundle needs.
        """
        found = found.in_table(self._pipeline.table, signed=is_signed(self._device.hello))
        self._pipeline.use_reference(found, fresh=fresh)
        self.reference = found

    def capture(self, frames: int, *, force: bool = False) -> Reference:
        """Use the mean of the next frames as the reference, and return it; the loop must not run.

        Args:
            frames: How many.
            force: Accept it even if the sheet was bent, touched or moving (:mod:`eitskin.reference.judged`).

        Raises:
            BadReference: The sheet was bent, touched or moving, or nothing is connected, or the frames did not come.
            PortLost: The port vanished.
            ValueError: Fewer than 2 frames, or too many.
        """
        builder, checks = ReferenceBuilder(frames, self._pipeline.skin, table=self._pipeline.table), self._checks()
        asked_ns, first = time.perf_counter_ns(), True
        for _ in self._accepted(asked_ns + int(self._patience_s(frames) * 1e9)):
            # The newest frame that waited may be the first to be accepted; a reference is of the sheet as it is now.
            before, first = first and self._pipeline.record.scanned_ns < asked_ns, False
            if before:
                continue
            if unfit := self._unfit_for_reference():
                builder.leave_out(unfit)
            elif builder.add(self._pipeline.normaliser.voltages()):
                found = builder.finish(self._device.hello, checks, force=force)
                self.use_reference(found, fresh=True)
                return found
        if self.source.stopping:
            raise BadReference("stopped while capturing the reference")
        raise BadReference(
            f"only {builder.taken} of {frames} frames for the reference arrived: is the device streaming?"
        )

    def recapture(self, frames: int, *, force: bool = False) -> Reference:
        """Capture a new reference while the loop runs, from another thread.

        Args:
            frames: How many.
            force: As in :meth:`capture`.

        Raises:
            BadReference: As in :meth:`capture`; or the loop was stopped, or another one is being captured. The old
                reference stays.
        """
        builder = ReferenceBuilder(frames, self._pipeline.skin, table=self._pipeline.table)
        recapture = Recapture(builder, self._checks(), force=force)
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

    def _checks(self) -> ReferenceChecks:
        health = self._pipeline.health
        missing = None if health is None else health.electrodes.missing.copy()
        return reference_checks(self._pipeline.bundle, self.reference, missing)

    def _patience_s(self, frames: int) -> float:
        return CAPTURE_S + frames / max(self._device.hello.rate_mHz / 1000, 1e-3)

    def _unfit_for_reference(self) -> str:
        """Return why the frame in hand is not one of a reference, or ""."""
        if "saturated" in self._pipeline.record.events:
            return "rows are cut off"
        return self._pipeline.front_end.check(self._pipeline.normaliser)

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
            self.use_reference(found, fresh=True)
            self._pipeline.record.note("reference")
        except SkinError as error:
            recapture.settle(error)
        else:
            recapture.settle(found)
