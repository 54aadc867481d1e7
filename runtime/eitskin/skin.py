"""A skin, opened: ``for frame in skin.frames()`` in this process, or the source of what ``eitskin run`` publishes.

Opening does everything that may fail early, in the order in which it is cheapest to fail: bundle, port, handshake,
solvers. Then :mod:`eitskin.frame_loop` runs. Clouds, new references and ``stop`` may come from other threads at any
time; the loop picks them up between two frames.
"""

import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from eitskin.acquisition.device import Device
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
from eitskin.reference.captured import DEFAULT_FRAMES, Reference
from eitskin.reference.plausible import check_prediction
from eitskin.stream_source import status_of, with_streams
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
        self._revision = 0
        pipeline.start_with(self._graph.geometry(None, None, 0))
        self._graph.close_sessions()

    def use(
        self,
        cloud: npt.ArrayLike | None,
        predicted: npt.ArrayLike | None,
        predicted_flat: npt.ArrayLike | None,
        reference: Reference | None,
    ) -> tuple[int, tuple[str, ...]]:
        """Use a surface from the next frame on, and return its revision and what is doubtful; from any thread.

        Args:
            cloud: (3, rows, columns) mm in any pose; None for the flat sheet.
            predicted: (104,) V of this surface untouched; None for no prediction.
            predicted_flat: (104,) V of the flat sheet by the same model; None takes the reference.
            reference: What frames are held against.

        Raises:
            ValueError: The cloud or the voltages are malformed, or cannot be of this sheet; with value and bound.
            BadReference: There is a prediction, but nothing to hold it against.
        """
        skin, doubts = self._pipeline.skin, tuple[str, ...]()
        if cloud is not None:
            cloud, doubts = check_sheet(cloud, skin)
            cloud = cloud.astype(np.float32).astype(np.float64)  # as control requests and streams carry it
        ratio: npt.NDArray[np.float32] | None = None
        if predicted is not None:
            surface = skin.grid.flat_cloud_mm() if cloud is None else cloud
            check_prediction(surface, predicted, predicted_flat, reference, skin)
            fills = self._pipeline.health is not None
            ratio = prediction_against(predicted, predicted_flat, reference, fills=fills)
        with self._lock:
            geometry = self._graph.geometry(cloud, ratio, self._revision + 1)
            self._revision += 1
            self._pipeline.use_geometry(replace(geometry, given=_given(cloud, predicted, predicted_flat)))
            return geometry.revision, doubts


def _given(
    cloud: npt.ArrayLike | None, predicted: npt.ArrayLike | None, predicted_flat: npt.ArrayLike | None
) -> GivenCloud:
    """Return copies of what was given, for whoever wants to compute it once more."""
    points = None if cloud is None else np.array(cloud, dtype=np.float32)
    volts = [None if one is None else np.array(one, dtype=np.float64) for one in (predicted, predicted_flat)]
    return GivenCloud(points, volts[0], volts[1], time.perf_counter_ns(), time.time_ns())


class Skin:
    """An open skin; leave it with ``close`` or as a context manager.

    Args:
        port: A serial port's path, ``usb:SERIAL``, or an open transport, which is closed with the skin.
        bundle: A bundle, its path, or the name of a shipped one; None takes the shipped one that knows the touches.
        reference: A reference, or its path; None if it will be captured.
        budget_ms: From read to publish; None for no budget.
        baud: Bits per second on a real UART.
        solver: The most accurate solver to use: ``vd2t``, ``vd2t-int8``, ``vd2t-small`` or ``tikhonov``; None for the
            bundle's own choice (:func:`eitskin.model.engine.default_solver`) or, with a budget, its most accurate one.
        skip_unchanged: Whether a frame keeps the map of an earlier one while only noise lies between them
            (:mod:`eitskin.pipeline.stillness`).
        idle_after_s: Let the device scan a few drives only once the sheet has been untouched for so long
            (:mod:`eitskin.pipeline.idle`); None scans all of them always.
        exclude: Electrodes to go on without; what fails while the stream goes on is found by itself.
        compensate_drift: Whether frames are freed of drift (:mod:`eitskin.health.drift`); None if the bundle can.
        skin: Its description, or that file's path, which the bundle must fit; None takes the bundle's.
        touches: Which way touches change conductance, ``lower``, ``raise`` or ``both``: the bundle must know them. None
            for what the skin's description says, or any that the bundle knows.

    Raises:
        BundleError: The bundle cannot be used, or has no idle gate where one is asked for.
        TransportError: The port is missing, busy, denied or lost.
        HandshakeError: The device does not answer, or measures in a way that cannot be used, or idles in another way.
        MismatchError: Bundle, device or reference belong to another protocol, skin, device or configuration.
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
        compensate_drift: bool | None = None,
        skin: SkinChoice = None,
        touches: TouchKind | None = None,
    ) -> None:
        budget_ns = in_ns(budget_ms)
        self.bundle, self.description = bundle_and_skin(bundle, skin, touches)
        loaded = references.taken(reference, self.description)
        self.transport = open_line(port, baud) if isinstance(port, str) else port
        try:
            self.device = Device(self.transport, self.description)
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
        """What frames are held against; None until it is captured."""
        return self.loop.reference

    @property
    def recoveries(self) -> int:
        """How often the device was greeted anew after silence or a reset."""
        return self.loop.source.recoveries

    @property
    def published(self) -> int:
        """Frames packed so far."""
        return self.loop.published

    def capture_reference(self, frames: int = DEFAULT_FRAMES, *, force: bool = False) -> Reference:
        """Take the mean of the next frames as the reference, and return it; the sheet must be flat and untouched.

        Args:
            frames: How many.
            force: Take it even if the sheet was bent, touched or moving (:mod:`eitskin.reference.judged`).

        Raises:
            BadReference: The sheet was bent, touched or moving, or nothing is connected, or the frames did not come.
            PortLost: The port vanished.
            ValueError: Fewer than 2 frames.
        """
        return self.loop.capture(frames, force=force)

    def recapture(self, frames: int, *, force: bool = False) -> dict[str, object]:
        """Capture one as :meth:`capture_reference` does, from another thread while frames go on; return what was found.

        Raises:
            BadReference: As in :meth:`capture_reference`; the old reference stays.
        """
        return self.loop.recapture(frames, force=force).answer()

    def set_cloud(
        self,
        cloud: npt.ArrayLike | None,
        predicted: npt.ArrayLike | None = None,
        predicted_flat: npt.ArrayLike | None = None,
    ) -> int:
        """Use a measured surface from the next frame on, and return its revision; frames do not wait for any of it.

        Args:
            cloud: (3, rows, columns) mm in any pose; None for the flat sheet.
            predicted: (104,) V, what the forward model says of this surface untouched.
            predicted_flat: (104,) V, what the same model says of the flat sheet; None takes the reference.

        Raises:
            ValueError: The cloud or the voltages are malformed, or cannot be of this sheet; with value and bound.
            BadReference: There is a prediction, but nothing to hold it against.
        """
        return self.use_cloud(cloud, predicted, predicted_flat)[0]

    def use_cloud(
        self,
        cloud: npt.ArrayLike | None,
        predicted: npt.ArrayLike | None = None,
        predicted_flat: npt.ArrayLike | None = None,
    ) -> tuple[int, tuple[str, ...]]:
        """Use a measured surface as :meth:`set_cloud` does; return its revision and what is doubtful about it."""
        return self._clouds.use(cloud, predicted, predicted_flat, self.reference)

    def exclude(self, electrodes: tuple[int, ...]) -> None:
        """Go on without these electrodes from the next frame on; may be called from any thread.

        Args:
            electrodes: By number; none uses all of them again that were left out by hand.

        Raises:
            BundleError: The bundle does not know how to go on without an electrode.
            ValueError: One does not exist, or there are too many.
        """
        self.pipeline.exclude(electrodes)

    def frames(self, *, timeout_s: float | None = None, touches: bool = False) -> Iterator[Frame]:
        """Yield frames as they come, in this process; each owns its map.

        Args:
            timeout_s: End after so long; None goes on until ``stop``.
            touches: Whether each has ``frame.touches``.

        Raises:
            BadReference: There is no reference yet.
            PortLost: The port vanished.
            HandshakeError: The device fell silent and does not answer, or came back as another one.
        """
        here = LastMessage(touches=touches)
        for _ in self.loop.run(here, None if timeout_s is None else time.perf_counter_ns() + int(timeout_s * 1e9)):
            yield unpack_frame(here.message, time.perf_counter_ns())

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
        """Return counters and ids; may be called from any thread."""
        return status_of(self.device, self.pipeline, self.loop)

    def summary(self) -> dict[str, Any]:
        """Return statistics and state as one flat object for ``--json``."""
        return {**self.status(), **self.statistics.summary()}

    @property
    def stopping(self) -> bool:
        """Whether ``stop`` was called."""
        return self.loop.source.stopping

    def stop(self) -> None:
        """End the loops soon; may be called from any thread and from a signal handler."""
        self.loop.stop()

    def close(self) -> None:
        """Stop the device and give the port back; closing twice is fine."""
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
"""How often it is asked who subscribes: so long a newcomer waits, at most, for what nobody else wanted."""


def serve(
    skin: Skin,
    publisher: Publisher,
    *,
    frames: int | None = None,
    until_ns: int | None = None,
    behind: Callable[[FrameRecord], None] | None = None,
) -> None:
    """Publish frames until ``skin.stop()``, a number of frames, or a time.

    A frame that nobody subscribed to is read, decoded and judged by the gate, but neither computed nor packed.

    Args:
        skin: Open, with a reference.
        publisher: Bound.
        frames: How many to go through; None for no limit.
        until_ns: When to end, on ``perf_counter_ns``; None for no limit.
        behind: Called with each frame's record when it has gone out; the next frame waits for it.

    Raises:
        PortLost: The port vanished.
        HandshakeError: The device fell silent and does not answer, or came back as another one.
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
                    skin.pipeline.maps.compute_next()
