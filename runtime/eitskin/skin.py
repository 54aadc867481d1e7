"""A skin, opened: ``for frame in skin.frames()`` in this process, or the source of what ``eitskin run`` publishes.

Opening does everything that may fail early, in the order in which it is cheapest to fail: bundle, port, handshake,
solvers. Then the stream runs, and the loop blocks in the transport's ``read`` and nowhere else. Clouds, new references
and ``stop`` may come from other threads at any time; the loop picks them up between two frames.
"""

import math
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from eitskin.acquisition.device import Device
from eitskin.acquisition.ports import open_line
from eitskin.acquisition.serial_port import DEFAULT_BAUD
from eitskin.acquisition.transport import Transport
from eitskin.errors import BadReference, BundleError, HandshakeError, PortReturned, SkinError
from eitskin.health.imputation import MISSING
from eitskin.health.monitor import health_of
from eitskin.messaging.frame import TOUCHED, Frame, FramePacker, unpack_frame
from eitskin.messaging.regions import Region, union
from eitskin.model.bundle import Bundle, load_bundle
from eitskin.model.engine import GeometryGraph
from eitskin.pipeline.frame_pipeline import INFER, PACK, PUBLISH, READ, Pipeline
from eitskin.pipeline.idle import IdleGate, IdleMode
from eitskin.pipeline.region_worker import Cutter
from eitskin.pipeline.stats import Statistics
from eitskin.reference import captured as references
from eitskin.reference.captured import DEFAULT_FRAMES, Reference, ReferenceBuilder
from eitskin.reference.predicted import log_ratio
from eitskin_proto.wire.answers import Event
from eitskin_proto.wire.codes import MessageType, Mode
from eitskin_proto.wire.frames import FRAME_TYPE

CAPTURE_S = 30.0
"""How long capturing a reference may take before it is given up, beyond what its frames take."""


MAP_UNCHANGED = ("map:unchanged",)

LEISURE_S = 0.001
"""The line rests if nothing comes for so long; what was published has been handed over by then."""

MOST_FRUITLESS = 5
"""How often a device is greeted anew without a single payload in between."""


class Skin:
    """An open skin; leave it with ``close`` or as a context manager.

    Args:
        port: A serial port's path, ``usb:SERIAL``, or an open transport, which is then closed with the skin.
        bundle: A bundle, or its path; None takes the shipped one.
        reference: A reference, or its path; None if it will be captured.
        budget_ms: From read to publish; None for no budget.
        baud: Bits per second on a real UART.
        solver: The most accurate solver to use: ``vd2t``, ``vd2t-int8`` or ``tikhonov``; None for the bundle's own
            choice (:func:`eitskin.model.engine.default_solver`) or, with a budget, its most accurate one.
        skip_unchanged: Whether a frame keeps the map of an earlier one while only noise lies between them
            (:mod:`eitskin.pipeline.stillness`).
        idle_after_s: Let the device scan a few drives only once the sheet has been untouched for so long
            (:mod:`eitskin.pipeline.idle`); None scans all of them always.
        exclude: Electrodes to go on without; what fails while the stream goes on is found by itself.
        compensate_drift: Whether to take out of the frames what the reference has drifted
            (:mod:`eitskin.health.drift`).

    Raises:
        BundleError: The bundle cannot be used, or has no idle gate where one is asked for.
        TransportError: The port is missing, busy, denied or lost.
        HandshakeError: The device does not answer, or measures in a way that cannot be used, or idles in another way.
        MismatchError: Bundle, device or reference belong to another protocol, grid, device or configuration.
        BadReference: The reference's file cannot be used.
        BudgetError: No solver meets the budget.
        ValueError: The budget or idle_after_s is not positive, or the bundle has no such solver.
    """

    def __init__(
        self,
        port: str | Transport,
        *,
        bundle: Bundle | str | Path | None = None,
        reference: Reference | str | Path | None = None,
        budget_ms: float | None = None,
        baud: int = DEFAULT_BAUD,
        solver: str | None = None,
        skip_unchanged: bool = False,
        idle_after_s: float | None = None,
        exclude: tuple[int, ...] = (),
        compensate_drift: bool = False,
    ) -> None:
        if budget_ms is not None and not 0 < budget_ms < 1e6:
            raise ValueError(f"budget_ms is {budget_ms}, expected more than 0 and less than 1e6")
        self.bundle = bundle if isinstance(bundle, Bundle) else load_bundle(bundle, lazily=True)
        loaded = references.load(reference) if isinstance(reference, str | Path) else reference
        self.transport: Transport = open_line(port, baud) if isinstance(port, str) else port
        try:
            self.device = Device(self.transport)
            if loaded is not None:
                loaded.check(self.device.hello)
            budget_ns = None if budget_ms is None else round(budget_ms * 1e6)
            self.pipeline = Pipeline(
                self.bundle, self.device.hello, budget_ns, solver=solver, skip_unchanged=skip_unchanged
            )
            self.pipeline.health = health_of(self.bundle, exclude=exclude, compensate_drift=compensate_drift)
            self._idle: IdleMode | None = None
            if idle_after_s is not None:
                self._idle = IdleMode(idle_after_s)
                self.pipeline.idle_gate = IdleGate(self.bundle.gate_arrays(), self.device.hello)
            self._geometry = GeometryGraph(self.bundle)
            self.pipeline.buffers.take(self._geometry.geometry(None, None, 0))
            self._geometry.rest()
            self.reference: Reference | None = None
            self.reference_file: Path | None = None
            """Where a reference that is captured on request is stored as well."""
            if loaded is not None:
                self._use(loaded)
        except BaseException:
            self.transport.close()
            raise
        self.statistics = Statistics()
        self.recoveries = 0
        """How often the device was greeted anew after silence or a reset."""
        self.published = 0
        """Frames packed so far."""
        self._started = False
        self._sent_map = -1
        """The frame whose map went out last."""
        self._packed_map = -2
        """The frame whose map the packer holds; -1 for one that is zero."""
        self._fruitless = 0
        self._revision = 0
        self._lock = threading.Lock()
        self._stopping = False
        self._closed = False
        self._heard_ns = time.perf_counter_ns()
        self._pending_events: tuple[str, ...] = ()
        self._capture: _Capture | None = None
        self._cutter = Cutter(self.pipeline, self.bundle)
        self.packer = FramePacker(
            configuration=self.device.configuration,
            bundle=self.bundle.id,
            serial_number=self.device.hello.serial_number,
            run=os.urandom(4).hex(),
        )

    # -- reference -----------------------------------------------------------------------------------------------------

    def capture_reference(self, frames: int = DEFAULT_FRAMES) -> Reference:
        """Take the mean of the next frames as the reference, and return it; the sheet must be flat and untouched.

        Args:
            frames: How many.

        Raises:
            BadReference: The sheet moved, or nothing is connected, or the frames did not come.
            PortLost: The port vanished.
            ValueError: Fewer than 2 frames.
        """
        builder = ReferenceBuilder(frames)
        rate_hz = max(self.device.hello.rate_mHz / 1000, 1e-3)
        until_ns = time.perf_counter_ns() + int((CAPTURE_S + frames / rate_hz) * 1e9)
        for _ in self._accepted(until_ns):
            if self._fit_for_reference() and builder.add(self.pipeline.normaliser.voltages()):
                found = builder.finish(self.device.hello)
                self._use(found)
                return found
        if self._stopping:
            raise BadReference("stopped while the reference was captured")
        raise BadReference(f"only {builder.taken} of {frames} frames for the reference came; is the device streaming?")

    def recapture(self, frames: int) -> dict[str, object]:
        """Capture a new reference while frames go on, from another thread; return what was captured.

        Raises:
            BadReference: As in :meth:`capture_reference`; the old reference stays.
        """
        capture = _Capture(ReferenceBuilder(frames))
        self._capture = capture
        rate_hz = max(self.device.hello.rate_mHz / 1000, 1e-3)
        if not capture.done.wait(CAPTURE_S + frames / rate_hz):
            self._capture = None
            raise BadReference(f"only {capture.builder.taken} of {frames} frames for the reference came")
        if capture.error is not None:
            raise capture.error
        assert self.reference is not None
        return {"frames": frames, "weak_rows": self.reference.weak.tolist()}

    def _fit_for_reference(self) -> bool:
        return "saturated" not in self.pipeline.events

    def _use(self, found: Reference) -> None:
        self.pipeline.use_reference(found)
        self.reference = found

    def _feed_capture(self, capture: "_Capture") -> None:
        if not self._fit_for_reference() or not capture.builder.add(self.pipeline.normaliser.voltages()):
            return
        self._capture = None
        try:
            found = capture.builder.finish(self.device.hello)
            if self.reference_file is not None:
                references.save(found, self.reference_file)
            self._use(found)
            self.pipeline.events += ("reference",)
        except SkinError as error:
            capture.error = error
        capture.done.set()

    # -- cloud ---------------------------------------------------------------------------------------------------------

    def set_cloud(
        self,
        cloud: npt.ArrayLike | None,
        predicted: npt.ArrayLike | None = None,
        predicted_flat: npt.ArrayLike | None = None,
    ) -> int:
        """Use a scanned surface from the next frame on, and return its revision; may be called from any thread.

        The geometry graph runs here, in the caller's thread: frames do not wait for it.

        Args:
            cloud: (3, 30, 45) mm in any pose; None for the flat sheet.
            predicted: (104,) V, what the forward model says of this surface untouched.
            predicted_flat: (104,) V, what the same model says of the flat sheet; None takes the reference.

        Raises:
            ValueError: The cloud or the voltages are malformed; with the value and the bound.
            BadReference: There is a prediction, but nothing to hold it against.
        """
        ratio: npt.NDArray[np.float32] | None = None
        if predicted is not None:
            against = predicted_flat
            if against is None:
                if self.reference is None:
                    raise BadReference("a prediction needs predicted_flat, or a captured reference to hold it against")
                against = self.reference.voltages_V
            ratio = log_ratio(predicted, against)
            if self.reference is not None and (predicted_flat is None or self.pipeline.health is None):
                ratio[self.reference.weak] = 0.0  # else those rows are filled in, and held against the prediction
        with self._lock:
            geometry = self._geometry.geometry(cloud, ratio, self._revision + 1)
            self._revision += 1
            self.pipeline.use_geometry(geometry)
            return geometry.revision

    # -- regions -------------------------------------------------------------------------------------------------------

    def set_regions(self, regions: Iterable[Region]) -> None:
        """Compute only the union of some regions, from a frame soon after; none of them means the whole sheet.

        What computes them is made in a thread of its own, since cutting a network takes tens of milliseconds; until
        then frames have what they had before. Every frame says what it has.
        """
        self._cutter.want(union(regions))

    def exclude(self, electrodes: tuple[int, ...]) -> None:
        """Go on without these electrodes from the next frame on; may be called from any thread.

        Args:
            electrodes: By number; none uses all of them again that were left out by hand.

        Raises:
            BundleError: The bundle does not know how to go on without an electrode.
            ValueError: One does not exist, or there are too many.
        """
        if self.pipeline.health is None:
            raise BundleError(f"{self.bundle.path}: excluding electrodes is {MISSING}")
        self.pipeline.health.exclude(electrodes)

    # -- frames --------------------------------------------------------------------------------------------------------

    def frames(self, *, timeout_s: float | None = None) -> Iterator[Frame]:
        """Yield frames as they come, in this process; each owns its map.

        Args:
            timeout_s: End after so long; None goes on until ``stop``.

        Raises:
            BadReference: There is no reference yet.
            PortLost: The port vanished.
            HandshakeError: The device fell silent and does not answer, or came back as another one.
        """
        until_ns = None if timeout_s is None else time.perf_counter_ns() + int(timeout_s * 1e9)
        for _ in self.readings(lambda: True, until_ns):
            message = bytes(self.pack())
            self.finish()
            yield unpack_frame(message, time.perf_counter_ns())

    def readings(self, wanted: Callable[[], bool], until_ns: int | None = None) -> Iterator[None]:
        """Yield whenever the pipeline holds a frame that is fit to publish; it is overwritten by the next.

        Args:
            wanted: Asked once a frame: does anybody take it?
            until_ns: When to end, on ``perf_counter_ns``; None goes on until ``stop``.
        """
        if self.reference is None:
            raise BadReference(
                "there is no reference: call capture_reference() with the sheet flat and untouched, or open the skin "
                "with reference=FILE"
            )
        for _ in self._accepted(until_ns):
            capture = self._capture
            if capture is not None and not self.pipeline.idle:
                self._feed_capture(capture)
            if self.pipeline.compute(wanted()):
                self._choose_mode(whole=capture is not None)
                yield

    def _choose_mode(self, *, whole: bool) -> None:
        """Ask the device for whole scans, or for those of a few drives, if this frame is a reason to."""
        pipeline = self.pipeline
        if self._idle is not None:
            lacking = pipeline.health is not None and pipeline.health.watch.missing.any()
            touched = whole or pipeline.touched or bool(lacking)  # the idle gate knows no missing rows
            mode = self._idle.step(pipeline.stamps[READ], touched=touched, idle=pipeline.idle)
            if mode is not None:
                self.device.ask_mode(mode)

    def pack(self, *, short: bool = False) -> memoryview:
        """Return the message of the frame that the pipeline holds, with publishing stamped as now.

        Args:
            short: Leave the map out if it is that of the frame before, which every subscriber has.
        """
        pipeline, packer, stamps = self.pipeline, self.packer, self.pipeline.stamps
        self.published += 1
        short = short and pipeline.map_sequence == self._sent_map
        self._sent_map = pipeline.map_sequence
        if not short:
            packed = -1 if pipeline.map_is_zero else pipeline.map_sequence
            if packed != self._packed_map:
                packer.put_map(pipeline.zero_bytes if pipeline.map_is_zero else pipeline.map_bytes)
                self._packed_map = packed
        stamps[PACK] = time.perf_counter_ns()
        pipeline.judge(stamps[PACK])
        if short:
            pipeline.skipped += MAP_UNCHANGED
        drift, out = math.nan, tuple[str, ...]()
        if (health := pipeline.health) is not None:
            drift, out = health.drift.percent, health.watch.texts
        packer.put_texts(pipeline.solver, pipeline.skipped, pipeline.events, pipeline.regions, out)
        stamps[PUBLISH] = time.perf_counter_ns()
        age_us = max(0, (stamps[PUBLISH] - pipeline.scanned_ns) // 1000)
        packer.put_numbers(
            (self.published, pipeline.sequence, pipeline.device_us, age_us, TOUCHED[pipeline.touched],
             pipeline.gate_logit, pipeline.buffers.revision, pipeline.normaliser.weak_count, pipeline.map_sequence,
             drift, *stamps, pipeline.counter.lost, self.device.deframer.corrupt, pipeline.withheld_total,
             pipeline.ladder.overruns)
        )  # fmt: skip
        return packer.short_message() if short else packer.message()

    def pass_over(self) -> None:
        """Leave out packing, since nobody takes the frame."""
        self.pipeline.stamps[PACK] = self.pipeline.stamps[INFER]

    def finish(self) -> None:
        """Take note of the frame in the statistics; after it was handed over."""
        pipeline = self.pipeline
        pipeline.stamps[PUBLISH] = time.perf_counter_ns()
        self.statistics.add(pipeline.stamps, pipeline.solver, pipeline.touched, pipeline.skipped, pipeline.events)
        pipeline.note_health()

    def _accepted(self, until_ns: int | None) -> Iterator[None]:
        """Yield whenever the pipeline has accepted a frame; the loop that blocks in ``read``.

        What came before anybody asked is left out: a robot's first frame must not be an old one.
        """
        device, pipeline = self.device, self.pipeline
        self._start()
        backlog = True
        self._heard_ns = time.perf_counter_ns()
        while not self._stopping:
            wait_s = device.silence_s
            if until_ns is not None:
                wait_s = min(wait_s, (until_ns - time.perf_counter_ns()) * 1e-9)
                if wait_s <= 0:
                    return
            try:
                payloads = self._payloads(wait_s)
                if payloads and (backlog or pipeline.ladder.drops_stale):
                    payloads = self._newest(payloads)
                    backlog = False
            except PortReturned:
                self._recover()
                continue
            read_ns = device.read_ns
            if not payloads:
                self._look_after(read_ns)
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
                        pipeline.events += self._pending_events
                        self._pending_events = ()
                    yield
                    if self._stopping:
                        return
            if pipeline.generation_differs:
                self._recover()

    def _payloads(self, wait_s: float) -> list[bytes]:
        """Return what comes, waiting for it; if nothing comes for a moment, do what can wait, and wait on."""
        if self.pipeline.has_leisure_work:
            if payloads := self.device.payloads(LEISURE_S):
                return payloads
            self.pipeline.look_at_health()
        return self.device.payloads(wait_s)

    def _start(self) -> None:
        """Start the stream with the first frame that is asked for: what nobody reads would only grow old."""
        if not self._started:
            self._started = True
            self.device.start()
            self.pipeline.clock.anchor(self.device.time_sample)

    def _newest(self, payloads: list[bytes]) -> list[bytes]:
        """Return what to compute when time is short: of all frames that wait, the newest."""
        while more := self.device.payloads(0.0):
            payloads += more
            if len(payloads) > 64:
                break  # a device faster than this loop; the rest is stale next time
        for payload in payloads[:-1]:
            if payload[0] == FRAME_TYPE:
                self.pipeline.discard(payload)
            else:
                self._take_note(payload)
        return payloads[-1:]

    def _look_after(self, now_ns: int) -> None:
        if not self._stopping and (now_ns - self._heard_ns) * 1e-9 >= self.device.silence_s:
            self._recover()

    def _recover(self) -> None:
        if self._fruitless >= MOST_FRUITLESS:
            raise HandshakeError(
                f"{self.transport.name} answers and acknowledges START, but sent no frame after {MOST_FRUITLESS} "
                "attempts: power the device off and on; if that does not help, flash it"
            )
        self._fruitless += 1
        while True:
            try:
                self.device.recover()
                break
            except PortReturned:
                continue  # it vanished once more while it was greeted
        self.recoveries += 1
        self.pipeline.greet(self.device.hello)
        self.pipeline.clock.anchor(self.device.time_sample)
        self._pending_events = (*self._pending_events, "recovered")
        self._heard_ns = time.perf_counter_ns()

    def _take_note(self, payload: bytes) -> None:
        if payload[0] == MessageType.EVENT and len(payload) == Event.LAYOUT.size and len(self._pending_events) < 8:
            self._pending_events = (*self._pending_events, f"device:{Event.unpack(payload).text.lower()}")

    # -- state ---------------------------------------------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """Return counters and ids; may be called from any thread."""
        pipeline, found = self.pipeline, self.reference
        return {
            "frames": self.statistics.frames,
            "published": self.published,
            "lost": pipeline.counter.lost,
            "corrupt": self.device.deframer.corrupt,
            "withheld": pipeline.withheld_total,
            "withheld_by_reason": dict(pipeline.withheld),
            "resets": pipeline.counter.resets,
            "recoveries": self.recoveries,
            "overruns": pipeline.ladder.overruns,
            "level": pipeline.ladder.level,
            "cloud": pipeline.buffers.revision,
            "idle": pipeline.idle,
            "mode_changes": 0 if self._idle is None else self._idle.switches,
            "regions": [list(region.bounds) for region in pipeline.regions],
            "clock_drift_ppm": round(pipeline.clock.drift_ppm, 3),
            "wire_delay_us": pipeline.clock.shortest_delay_us,
            "serial_number": self.device.hello.serial_number,
            "configuration": self.device.configuration,
            "bundle": self.bundle.id,
            "reference_utc": found.captured_utc if found else "",
            "weak_rows": found.weak.tolist() if found else [],
            "electrodes": [] if pipeline.health is None else list(pipeline.health.watch.texts),
        }

    def summary(self) -> dict[str, Any]:
        """Return the statistics and the state as one flat object for ``--json``."""
        return {**self.status(), **self.statistics.summary()}

    @property
    def stopping(self) -> bool:
        """Whether ``stop`` was called."""
        return self._stopping

    def stop(self) -> None:
        """End the loops soon; may be called from any thread and from a signal handler."""
        self._stopping = True
        self.transport.cancel()

    def close(self) -> None:
        """Stop the device and give the port back; closing twice is fine."""
        if self._closed:
            return
        self._closed = True
        self._stopping = True
        with suppress(SkinError):  # the port may be gone; then there is nothing to stop
            self.device.stop()
            if self.device.idle:
                self.device.ask_mode(Mode.ACTIVE)  # whoever comes next finds it as it was
        self.transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class _Capture:
    """A reference that another thread asked for and waits for."""

    __slots__ = ("builder", "done", "error")

    def __init__(self, builder: ReferenceBuilder) -> None:
        self.builder = builder
        self.done = threading.Event()
        self.error: SkinError | None = None
