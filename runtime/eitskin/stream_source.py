"""Sends measurements from the frame loop to a publisher's streams.

The frame loop calls it for each frame while a stream has a subscriber, after the frame's own message went out and its
subscriber had a moment (:mod:`eitskin.frame_loop`). So no frame waits for it. ::

    conditions, cloud, state     when they change, when a subscriber comes (conditions at once), and once a second
    wire                         every frame, last: after everything that decides its map
"""

import hashlib
import time
from collections import deque
from importlib import metadata
from typing import Any, Final

import numpy as np

from eitskin.acquisition.device import Device
from eitskin.frame_loop import FrameLoop
from eitskin.messaging.frame import host_id
from eitskin.messaging.regions import whole
from eitskin.messaging.streams.envelope import CLOUD, CONDITIONS, STATE, WIRE
from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
from eitskin.messaging.streams.publisher import StreamPublisher
from eitskin.messaging.streams.state import MOST_EVENTS, Event, SkinState
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference, stored


def status_of(device: Device, pipeline: Pipeline, loop: FrameLoop) -> dict[str, Any]:
    """Return counters and ids; may be called from any thread.

    Args:
        device: The skin's.
        pipeline: The skin's.
        loop: Between the two.
    """
    record, intake, found, health = pipeline.record, pipeline.intake, loop.reference, pipeline.health
    return {
        "frames": loop.statistics.frames,
        "published": loop.published,
        "touched": loop.statistics.touched,
        "lost": intake.counter.lost,
        "corrupt": device.deframer.corrupt,
        "withheld": intake.withheld_total,
        "withheld_by_reason": dict(intake.withheld),
        "resets": intake.counter.resets,
        "recoveries": loop.source.recoveries,
        "trouble": loop.source.trouble,
        "overruns": pipeline.budget.overruns,
        "level": pipeline.budget.level,
        "cloud": record.cloud,
        "cloud_why": "start" if pipeline.buffers.geometry is None else pipeline.buffers.geometry.why,
        "idle": record.idle,
        "mode_changes": 0 if loop.idle is None else loop.idle.switches,
        "regions": [list(region.bounds) for region in whole(pipeline.skin.grid.shape)],
        "clock_drift_ppm": round(intake.clock.drift_ppm, 3),
        "wire_delay_us": intake.clock.shortest_delay_us,
        "serial_number": device.hello.serial_number,
        "configuration": device.configuration,
        "bundle": pipeline.bundle.id,
        "labels": pipeline.bundle.labels,
        "touch_kind": pipeline.bundle.touch_kind,
        "skin": f"{pipeline.skin.name}/{pipeline.skin.digest}",
        "reference_utc": found.captured_utc if found else "",
        "weak_rows": found.weak.tolist() if found else [],
        "touch_doubt": pipeline.doubts.found,
        "frozen_rows": [] if health is None else np.flatnonzero(health.hanging).tolist(),
        "electrodes": [] if health is None else list(health.electrodes.texts),
        "shape": "" if pipeline.field is None else pipeline.field.shape,
        "drift": {} if health is None else health.drift.summary(),
        "verifier": loop.verifier_status(),
    }


REPEAT_NS: Final = 1_000_000_000
"""Period after which conditions, cloud and state are sent again, for subscribers that missed one."""

FILE_REPEATS: Final = 10
"""One of this many states carries the reference's file, which is its largest part."""

LEAST_NS: Final = 50_000_000
"""Shortest time between two states: faster changes are sent together."""

JOIN_NS: Final = 200_000_000
"""Shortest time between two repetitions for new subscribers, which bounds the cost of frequent subscriptions."""


class StreamSource:
    """Feeds one publisher at a time.

    Args:
        device: The skin's.
        pipeline: The skin's.
        loop: Between the two.
    """

    def __init__(self, device: Device, pipeline: Pipeline, loop: FrameLoop) -> None:
        self._device, self._pipeline, self._loop = device, pipeline, loop
        self._streams = StreamPublisher(lambda message: None)
        self._reference: Reference | None = None
        self._file, self._digest = b"", ""
        self._conditions: Conditions | None = None
        self._conditions_key: tuple[Any, ...] = ()
        self._revision = 0
        self._geometry: object = None
        self._state_key: tuple[Any, ...] = ()
        self._repeat_ns = self._state_ns = 0
        self._states = 0
        self._events: deque[Event] = deque(maxlen=MOST_EVENTS)
        try:
            self._version = metadata.version("eitskin")
        except metadata.PackageNotFoundError:
            self._version = ""

    @property
    def asked(self) -> bool:
        """Whether any stream has a subscriber."""
        return self._streams.asked

    def begin(self, streams: StreamPublisher, run: str) -> None:
        """Send to this publisher from now on, starting with everything.

        Args:
            streams: The publisher.
            run: Differs after each start of the runtime.
        """
        streams.run = run
        self._streams = streams
        self._conditions_key = self._state_key = ()
        self._geometry, self._repeat_ns = None, 0
        self._take_reference()

    def frame(self, payload: bytes, number: int | None) -> None:
        """Tell of the frame in hand.

        Args:
            payload: As it came.
            number: Of its published frame; None if there is none.
        """
        record, streams = self._pipeline.record, self._streams
        now_ns = record.stamps[0]
        if streams.state:
            self._events.extend((record.sequence, text) for text in record.events)
        joined, repeat = streams.joined, self._is_time(now_ns)
        self._publish_conditions(repeat=repeat or joined)
        if streams.cloud and (repeat or self._pipeline.buffers.geometry is not self._geometry):
            self._publish_cloud()
        if streams.state:
            self._publish_state(now_ns, repeat=repeat)
        if streams.wire:
            published = number is not None
            found = WireFrame(
                payload, record.sequence, now_ns, device_us=record.device_us, frame=number,
                touched=bool(record.touched), gate_logit=float(record.gate_logit),
                solver=record.solver if published else "none",
                map_seq=record.map_sequence if published else None, fused=record.fused if published else 1,
                conditions=self._revision,
            )  # fmt: skip
            streams.send(WIRE, found.body())

    def withheld(self, payload: bytes, read_ns: int) -> None:
        """Tell of a frame that was withheld just now.

        Args:
            payload: As it came.
            read_ns: When its last byte was in hand.
        """
        streams, intake = self._streams, self._pipeline.intake
        if not streams.asked:
            return
        if streams.wire:
            known = intake.last_reason != "malformed"
            seq = intake.counter.sequence if known else None
            device_us = intake.counter.device_us if known else None
            found = WireFrame(
                payload, seq, read_ns, device_us=device_us, withheld=intake.last_reason, conditions=self._revision
            )
            streams.send(WIRE, found.body())
        if streams.state and read_ns - self._state_ns >= REPEAT_NS:
            self._publish_state(read_ns, repeat=True)

    def _is_time(self, now_ns: int) -> bool:
        """Return whether everything must be sent again."""
        joined = self._streams.joined
        if now_ns - self._repeat_ns < (JOIN_NS if joined else REPEAT_NS):
            return False
        if joined:
            self._streams.joined, self._states = False, 0
        self._repeat_ns = now_ns
        return True

    def _take_reference(self) -> None:
        found = self._loop.reference
        if found is not self._reference:
            self._reference, self._states = found, 0
            self._file = b"" if found is None else stored(found)
            self._digest = "" if found is None else hashlib.sha256(self._file).hexdigest()

    def _publish_conditions(self, *, repeat: bool) -> None:
        """Send the conditions of the current frame if they have changed."""
        pipeline = self._pipeline
        record, health, gate = pipeline.record, pipeline.health, pipeline.gate
        threshold = None if gate is None else gate.threshold
        drift = (0, False) if health is None else (health.drift.changes, health.drift.active)
        findings = () if health is None else health.electrodes.findings
        volts = pipeline.normaliser.volts_per_count
        key = record.cloud, self._loop.reference, threshold, drift, findings, volts
        if key != self._conditions_key:
            self._conditions_key = key
            self._take_reference()
            self._revision += 1
            missing = () if health is None else np.flatnonzero(health.electrodes.missing).tolist()
            self._conditions = Conditions(
                revision=self._revision,
                seq=record.sequence,
                cloud=record.cloud,
                reference=self._digest,
                regions=whole(pipeline.skin.grid.shape),
                gate_threshold=threshold,
                drift=None if health is None else health.drift.factors,
                electrodes=tuple((one.electrode, one.state, one.partner) for one in findings),
                missing_rows=tuple(missing),
                skip_unchanged=pipeline.maps.keeps_unchanged,
                volts_per_count=volts,
            )
        elif not repeat:
            return
        if self._streams.conditions and self._conditions is not None:
            self._streams.send(CONDITIONS, self._conditions.body())

    def _publish_cloud(self) -> None:
        pipeline = self._pipeline
        self._geometry = found = pipeline.buffers.geometry
        if found is None:
            return
        given, flat = found.given, pipeline.skin.grid.flat_cloud_mm().astype(np.float32)
        told = CloudInUse(
            revision=found.revision,
            cloud=flat if given is None or given.cloud is None else given.cloud,
            predicted=None if given is None else given.predicted,
            predicted_flat=None if given is None else given.predicted_flat,
            taken_ns=0 if given is None else given.taken_ns,
            why=found.why,
            log_predicted=found.log_predicted[0],
            seq=pipeline.record.cloud_sequence,
            utc_ns=0 if given is None else given.utc_ns,
        )
        self._streams.send(CLOUD, told.body())

    def _publish_state(self, now_ns: int, *, repeat: bool) -> None:
        device, pipeline, loop = self._device, self._pipeline, self._loop
        record = pipeline.record
        key = device.hello, loop.reference, record.electrodes, record.cloud, record.idle, pipeline.budget.level
        changed = bool(self._events) or key != self._state_key
        if not (repeat or (changed and now_ns - self._state_ns >= LEAST_NS)):
            return
        self._take_reference()
        whole = self._states % FILE_REPEATS == 0
        self._states += 1
        self._state_key, self._state_ns = key, now_ns
        status = status_of(device, pipeline, loop)
        told = SkinState(
            hello=device.hello.pack(),
            host=host_id(),
            serial=device.hello.serial_number,
            configuration=device.configuration,
            bundle=pipeline.bundle.id,
            skin=str(status["skin"]),
            protocol_id=device.hello.protocol_id,
            grid_id=pipeline.skin.grid_id,
            version=self._version,
            solvers=tuple(engine.name for engine in pipeline.engines),
            status=status,
            reference_sha256=self._digest,
            reference=self._file if whole and self._file else None,
            events=tuple(self._events),
            made_ns=time.perf_counter_ns(),
            utc_ns=time.time_ns(),
        )
        self._events.clear()
        self._streams.send(STATE, told.body())


def with_streams(loop: FrameLoop, device: Device, pipeline: Pipeline) -> FrameLoop:
    """Return a frame loop that sends measurements to streams."""
    loop.feed = StreamSource(device, pipeline, loop)
    return loop
