"""An open skin: ``for frame in skin.frames()`` in this process, or the source of the frames of ``eitskin run``.

Opening first does everything that may fail, the cheapest first: bundle, port, handshake, solvers. Then
:mod:`eitskin.frame_loop` runs. Clouds, new references and ``stop`` may come from other threads at any time; the loop
picks them up between two frames.
"""

import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from eitskin.acquisition.device import Device
from eitskin.acquisition.drivers.driver import Driver, PolledDriver
from eitskin.acquisition.drivers.feed import Feed, line_of
from eitskin.acquisition.ports import open_line
from eitskin.acquisition.serial_port import DEFAULT_BAUD
from eitskin.acquisition.transport import Transport
from eitskin.errors import SkinError
from eitskin.frame_loop import FrameLoop, Taker
from eitskin.frame_record import READ, FrameRecord
from eitskin.health.monitor import health_of
from eitskin.messaging.frame import Frame, unpack_frame
from eitskin.messaging.frame_message import LastMessage
from eitskin.messaging.publish import Publisher
from eitskin.model.bundle import Bundle
from eitskin.model.geometry import GeometryGraph, GivenCloud
from eitskin.model.skin_in_use import SkinChoice, bundle_and_skin
from eitskin.pipeline.frame_pipeline import Pipeline, prediction_against
from eitskin.pipeline.idle import IdleGate, IdleMode
from eitskin.pipeline.latency_budget import in_ns
from eitskin.reference import captured as references
from eitskin.reference.builder import reference_of_scans
from eitskin.reference.captured import DEFAULT_FRAMES, Reference
from eitskin.reference.plausible import check_prediction
from eitskin.stream_source import status_of, with_streams
from eitskin_proto.skin.familiar_shape import unlike_family
from eitskin_proto.skin.sheet_cloud import check_sheet
from eitskin_proto.skin.touch_kind import TouchKind


class CloudChange:
    """Gives a pipeline the flat sheet first, and then every cloud that comes.

    Args:
        pipeline: It has not seen a frame yet.

    Raises:
        BundleError: The geometry graph cannot be loaded or has another signature.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._graph = GeometryGraph(pipeline.bundle)
        self._lock = threading.Lock()
        self._revision, self._is_sent = 0, False
        pipeline.start_with(self._graph.geometry(None, None, 0))
        self._graph.close_sessions()

    def use(
        self,
        cloud: npt.ArrayLike | None,
        predicted: npt.ArrayLike | None,
        predicted_flat: npt.ArrayLike | None,
        reference: Reference | None,
        *,
        is_fitted: bool = False,
    ) -> tuple[int, tuple[str, ...]]:
        """Use a surface from the next frame on, and return its revision and warnings; from any thread.

        Args:
            cloud: (3, rows, columns) mm in any pose; None for the flat sheet.
            predicted: (104,) V of this surface untouched; None for no prediction.
            predicted_flat: (104,) V of the flat sheet by the same model; None takes the reference.
            reference: The reference of the frames.
            is_fitted: Whether physics found it in frames: then a cloud that was sent stays in use.

        Raises:
            ValueError: The cloud or the voltages are malformed, or cannot be of this sheet; with value and bound.
            BadReference: There is a prediction, but no reference to compare it with.
        """
        skin, doubts, unlike = self._pipeline.skin, tuple[str, ...](), tuple[str, ...]()
        if cloud is not None:
            cloud, doubts = check_sheet(cloud, skin)
            unlike = unlike_family(cloud, skin)
            cloud = cloud.astype(np.float32).astype(np.float64)  # as control requests and streams carry it
        ratio: npt.NDArray[np.float32] | None = None
        if predicted is not None:
            surface = skin.grid.flat_cloud_mm() if cloud is None else cloud
            check_prediction(surface, predicted, predicted_flat, reference, skin)
            fills = self._pipeline.health is not None
            ratio = prediction_against(predicted, predicted_flat, reference, fills=fills)
        with self._lock:
            if is_fitted and self._is_sent:
                return self._revision, ()
            geometry = self._graph.geometry(cloud, ratio, self._revision + 1)
            self._revision += 1
            self._is_sent = cloud is not None and not is_fitted
            given = replace(_given(cloud, predicted, predicted_flat), is_fitted=is_fitted)
            self._pipeline.use_geometry(replace(geometry, given=given, unlike=unlike))
            return geometry.revision, doubts


def _given(
    cloud: npt.ArrayLike | None, predicted: npt.ArrayLike | None, predicted_flat: npt.ArrayLike | None
) -> GivenCloud:
    """Return copies of the given arrays, for computing them again."""
    points = None if cloud is None else np.array(cloud, dtype=np.float32)
    volts = [None if one is None else np.array(one, dtype=np.float64) for one in (predicted, predicted_flat)]
    return GivenCloud(points, volts[0], volts[1], time.perf_counter_ns(), time.time_ns())


class Skin:
    """An open skin, read in this process; close it with ``close`` or as a context manager.

    Args:
        port: A serial port's path, ``usb:SERIAL``, ``NAME:REST`` of a driver, or an open :class:`eitskin.Transport`,
            which ``close`` closes too; None with a source.
        bundle: A bundle, its path, or the name of a shipped one; None takes the shipped one that knows the touches.
        reference: A reference, its path, or (n, rows) or (rows,) V of the untouched sheet, of this device; None if you
            will call :meth:`capture_reference`.
        budget_ms: Time limit in ms from read to publish; None for no limit.
        baud: Bits per second, for a real UART.
        solver: The most accurate solver to use: ``vd2t``, ``vd2t-int8``, ``vd2t-small`` or ``tikhonov``. None takes the
            bundle's choice (:func:`eitskin.model.engine.default_solver`) or, with a budget, its most accurate one.
        skip_unchanged: Keep the previous map while only noise changes (:mod:`eitskin.model.stillness`).
        idle_after_s: Scan only a few drives after the sheet has been untouched for this many seconds
            (:mod:`eitskin.pipeline.idle`); None always scans all drives.
        exclude: Electrodes to exclude, by number. The runtime also detects failing electrodes by itself.
        compensate_drift: Whether to correct frames for drift (:mod:`eitskin.health.drift`); None if the bundle can.
        skin: The skin's description, or the path of its file, which the bundle must fit; None takes the bundle's.
        touches: ``lower``, ``raise`` or ``both``: how touches change conductance. The bundle must know such touches.
            None takes the skin description's kind, or accepts any bundle.
        source: In place of a port: a driver (:mod:`eitskin.acquisition.drivers.driver`), an :class:`eitskin.Feed`, or
            an iterable of (rows,) volts.

    Raises:
        BundleError: The bundle cannot be used, or lacks the idle gate that ``idle_after_s`` needs.
        TransportError: The port is missing, busy, denied or lost.
        HandshakeError: The device does not answer, or its way of measuring or idling is not supported.
        MismatchError: Bundle, device or reference belong to another protocol, skin, device or configuration.
        BadReference: The reference file cannot be used.
        BudgetError: No solver meets the budget.
        ValueError: ``budget_ms`` or ``idle_after_s`` is not positive, or the bundle has no such solver.
    """

    def __init__(
        self,
        port: str | Transport | None = None,
        *,
        bundle: Bundle | str | Path | None = None,
        reference: Reference | str | Path | npt.NDArray[np.floating] | None = None,
        budget_ms: float | None = None,
        baud: int = DEFAULT_BAUD,
        solver: str | None = None,
        skip_unchanged: bool = False,
        idle_after_s: float | None = None,
        exclude: tuple[int, ...] = (),
        compensate_drift: bool | None = None,
        skin: SkinChoice = None,
        touches: TouchKind | None = None,
        source: Driver | PolledDriver | Iterable[npt.ArrayLike] | None = None,
    ) -> None:
        if (port is None) == (source is None):
            raise ValueError("expected either port or source")
        budget_ns = in_ns(budget_ms)
        self.bundle, self.description = bundle_and_skin(bundle, skin, touches)
        measured = np.atleast_2d(reference) if isinstance(reference, np.ndarray) else None
        loaded = None if isinstance(reference, np.ndarray) else references.taken(reference, self.description)
        line = line_of(source) if port is None else open_line(port, baud) if isinstance(port, str) else port
        self.transport: Transport = line
        self._feed = source if isinstance(source, Feed) else None
        try:
            self.device = Device(self.transport, self.description)
            if measured is not None:
                loaded = reference_of_scans(measured, self.device.hello, self.description)
            if loaded is not None:
                loaded.check(self.device.hello)
            idle = None if idle_after_s is None else IdleMode(idle_after_s)
            self.pipeline = Pipeline(
                self.bundle,
                self.device.hello,
                budget_ns,
                solver=solver,
                skip_unchanged=skip_unchanged,
                health=health_of(self.bundle, exclude=exclude, compensate_drift=compensate_drift),
                idle_gate=None if idle is None else IdleGate(self.bundle.gate_arrays(), self.device.hello),
                skin=self.description,
            )
            self._clouds = CloudChange(self.pipeline)
            self.loop = with_streams(FrameLoop(self.device, self.pipeline, idle), self.device, self.pipeline)
            if loaded is not None:
                self.loop.use_reference(loaded)
        except BaseException:
            self.transport.close()
            raise
        self.statistics = self.loop.statistics
        self._closed = False

    def __repr__(self) -> str:
        state = "closed" if self._closed else f"open, {self.statistics.frames} frames"
        return f"<Skin {self.device.hello.serial_number} on {self.transport.name}: {state}>"

    @property
    def reference(self) -> Reference | None:
        """The reference in use; None until it is captured."""
        return self.loop.reference

    @property
    def recoveries(self) -> int:
        """How often the connection was re-established after silence or a reset of the device."""
        return self.loop.source.recoveries

    @property
    def published(self) -> int:
        """Frames packed so far."""
        return self.loop.published

    def capture_reference(self, frames: int = DEFAULT_FRAMES, *, force: bool = False) -> Reference:
        """Capture the mean of the next frames as the reference, use it, and return it.

        The sheet must be flat and untouched.

        Args:
            frames: Number of frames to average.
            force: Accept the reference even if the sheet is bent, touched or moving
                (:mod:`eitskin.reference.judged`).

        Raises:
            BadReference: The sheet is bent, touched or moving, no electrodes are connected, or frames do not come.
            PortLost: The port vanished.
            ValueError: ``frames`` is below 2.
        """
        return self.loop.capture(frames, force=force)

    def recapture(self, frames: int, *, force: bool = False) -> dict[str, object]:
        """Capture a new reference from another thread while frames go on; return the findings of the check.

        Args:
            frames: As for :meth:`capture_reference`.
            force: As for :meth:`capture_reference`.

        Raises:
            BadReference: As for :meth:`capture_reference`; the old reference stays in use.
        """
        return self.loop.recapture(frames, force=force).answer()

    def set_cloud(
        self,
        cloud: npt.ArrayLike | None,
        predicted: npt.ArrayLike | None = None,
        predicted_flat: npt.ArrayLike | None = None,
    ) -> int:
        """Use a measured surface from the next frame on, and return its revision; frames do not wait.

        Args:
            cloud: (3, rows, columns) mm in any pose; None for the flat sheet.
            predicted: (104,) V that the forward model computes for this surface untouched; None without.
            predicted_flat: (104,) V that the same model computes for the flat sheet; None takes the reference.

        Raises:
            ValueError: The cloud or the voltages are malformed or do not fit this sheet; with value and bound.
            BadReference: There is a prediction, but no reference to compare it with.
        """
        return self.use_cloud(cloud, predicted, predicted_flat)[0]

    def use_cloud(
        self,
        cloud: npt.ArrayLike | None,
        predicted: npt.ArrayLike | None = None,
        predicted_flat: npt.ArrayLike | None = None,
        *,
        is_fitted: bool = False,
    ) -> tuple[int, tuple[str, ...]]:
        """Use a surface as :meth:`set_cloud` does, or a fitted one if none was sent; return revision and warnings."""
        return self._clouds.use(cloud, predicted, predicted_flat, self.reference, is_fitted=is_fitted)

    def exclude(self, electrodes: tuple[int, ...]) -> None:
        """Exclude these electrodes from the next frame on, from any thread.

        Args:
            electrodes: Numbers from 0 to 15; an empty tuple includes all excluded ones again.

        Raises:
            BundleError: The bundle cannot work without an electrode.
            ValueError: A number does not exist, or there are too many.
        """
        self.pipeline.exclude(electrodes)

    def frames(self, *, timeout_s: float | None = None, touches: bool = False) -> Iterator[Frame]:
        """Yield frames as they come; each owns its map.

        Args:
            timeout_s: Stop after this many seconds; None continues until ``stop``.
            touches: Whether frames have ``frame.touches``.

        Raises:
            BadReference: There is no reference yet.
            PortLost: The port vanished.
            HandshakeError: The device stopped answering, or another device came back.
        """
        here = LastMessage(touches=touches)
        for _ in self.loop.run(here, None if timeout_s is None else time.perf_counter_ns() + int(timeout_s * 1e9)):
            yield unpack_frame(here.message, time.perf_counter_ns())

    def feed(self, voltages: npt.ArrayLike, device_us: int | None = None) -> Frame | None:
        """Take one scan of the program's own, and return its frame; None if it was withheld.

        The skin was opened with ``source=eitskin.Feed(...)``; ``status()["withheld_by_reason"]`` counts the reasons.

        Args:
            voltages: (rows,) V, real or complex, in the order of the feed's table.
            device_us: When it was made, in microseconds of the device's clock; None if unknown.

        Raises:
            BadReference: There is no reference yet.
            ValueError: The skin has another source, or the scan another number of rows.
        """
        if self._feed is None:
            raise ValueError("this skin reads a device, expected Skin(source=eitskin.Feed(...)) for feed()")
        self.loop.source.waits = False
        self.loop.source.begin()
        self._feed.put(voltages, device_us)
        here, found = LastMessage(touches=True), None
        for _ in self.loop.run(here):
            found = unpack_frame(here.message, time.perf_counter_ns())
        return found

    def publish(self, taker: Taker, until_ns: int | None = None) -> Generator[FrameRecord, None, None]:
        """Hand every frame's message to a taker, and yield each frame's record after that; the next overwrites it.

        Args:
            taker: A publisher, for one.
            until_ns: When to end, on ``perf_counter_ns``; None goes on until ``stop``.

        Raises:
            SkinError: As :meth:`frames`.
        """
        return self.loop.run(taker, until_ns)

    def status(self) -> dict[str, Any]:
        """Return counters and ids, from any thread."""
        return status_of(self.device, self.pipeline, self.loop)

    def summary(self) -> dict[str, Any]:
        """Return statistics and status as one flat object, as ``--json`` prints it."""
        return {**self.status(), **self.statistics.summary()}

    @property
    def stopping(self) -> bool:
        """Whether ``stop`` was called."""
        return self.loop.source.stopping

    def stop(self) -> None:
        """End :meth:`frames` soon, from any thread or a signal handler."""
        self.loop.stop()

    def close(self) -> None:
        """Stop the device and close the port; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        self.stop()  # a port that vanished is not waited for either
        with suppress(SkinError):  # the port may be gone; then there is nothing to stop
            self.device.leave()
        self.transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


JOIN_NS: Final = 10_000_000
"""Period of the check for subscribers: the longest wait of the first subscriber."""


def serve(
    skin: Skin,
    publisher: Publisher,
    *,
    frames: int | None = None,
    until_ns: int | None = None,
    behind: Callable[[FrameRecord], None] | None = None,
) -> None:
    """Publish frames until ``skin.stop()``, a number of frames, or a time.

    Without subscribers, a frame is read, decoded and checked by the gate, but no map is computed.

    Args:
        skin: An open skin with a reference.
        publisher: Where to publish.
        frames: Number of frames to process; None for no limit.
        until_ns: When to end, on ``perf_counter_ns``; None for no limit.
        behind: Called with each frame's record after it is published; the next frame waits for it.

    Raises:
        PortLost: The port vanished.
        HandshakeError: The device stopped answering, or another device came back.
    """
    next_join_ns = time.perf_counter_ns()
    publisher.update()
    with closing(skin.publish(publisher, until_ns)) as records:  # what is left of the last frame is done here, and now
        for record in records:
            if behind is not None:
                behind(record)
            if frames is not None and skin.statistics.frames >= frames:
                return
            now_ns = record.stamps[READ]
            if now_ns >= next_join_ns:  # behind a frame, not before it
                next_join_ns = now_ns + JOIN_NS
                publisher.update()
                if publisher.streams.joined:
                    skin.pipeline.maps.drop_map()
