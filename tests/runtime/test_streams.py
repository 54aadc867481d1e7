"""What was measured, from a virtual skin to a subscriber: enough to make every published map again, bit by bit."""

import itertools
import threading
import time

import numpy as np

import eitskin
from eitskin.health.imputation import Consistency
from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
from eitskin.messaging.streams.state import SkinState
from eitskin.model.bundle import load_bundle
from eitskin.model.geometry import GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.pipeline.recorded import RecordedHealth
from eitskin.reference import captured
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.wire.messages import Hello

CLOUD = PAPER.grid.flat_cloud_mm() + np.array([3.0, -200.0, 40.0])[:, None, None]
RATIO = np.linspace(0.97, 1.04, 104)


def until(items, condition, most=6000):
    """Return what comes up to the item for which a condition holds."""
    found = []
    for item in itertools.islice(items, most):
        found.append(item)
        if condition(item):
            return found
    raise AssertionError(f"not among {most} items")


class Listener:
    """All frames of a runtime, taken in a thread."""

    def __init__(self, endpoint, **options):
        self.frames = {}
        self._subscription = eitskin.subscribe(endpoint, "all", **options)
        self._first = threading.Event()
        self._ends = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        assert self._first.wait(60)

    def _run(self):
        while not self._ends:
            frame = next(self._subscription)
            self.frames[frame.run, frame.number] = frame
            self._first.set()

    def stop(self, number):
        """Wait for a frame of at least this number, and end."""
        end = time.perf_counter() + 60
        while max(which for _, which in self.frames) < number and time.perf_counter() < end:
            time.sleep(0.01)
        self._ends = True
        self._thread.join(60)
        assert not self._thread.is_alive()
        assert self._subscription.lost == 0
        self._subscription.close()
        return self.frames


def again(bundle, items, frames):
    """Make the map of every frame again from what the streams said; return how many there were that are not 0."""
    conditions = {item.revision: item for item in items if isinstance(item, Conditions)}
    clouds = {item.revision: item for item in items if isinstance(item, CloudInUse)}
    references = {item.reference_sha256: item.reference for item in items if isinstance(item, SkinState)}
    hello = Hello.unpack(next(item for item in items if isinstance(item, SkinState)).hello)
    wire = {item.seq: item for item in items if isinstance(item, WireFrame)}
    arrays = bundle.consistency_arrays()
    health = None if arrays is None else RecordedHealth(Consistency.of(arrays))
    made, graph, maps, seen, now = Pipeline(bundle, hello, 10**12, health=health), GeometryGraph(bundle), {}, 0, None
    for item in items:
        if not isinstance(item, WireFrame) or item.frame is None:
            continue
        assert item.withheld == ""
        found = conditions[item.conditions]
        if found is not now:
            if now is None or found.reference != now.reference:
                made.use_reference(captured.parsed(references[found.reference], "it", "none"))
            if now is None or found.cloud != now.cloud:
                cloud = clouds[found.cloud]
                given = cloud.cloud if cloud.why in ("given", "fitted") else None
                made.start_with(graph.geometry(given, cloud.log_predicted, cloud.revision))
            if health is not None and health.use_recorded(found.drift, found.electrodes):
                made.maps.change_projection(health.projection)
            now = found
        if item.solver != "none" and item.map_seq == item.seq:
            made.decisions.touched, made.decisions.solver = True, item.solver
            assert made.load_recorded(item.payload, item.seq)
            assert made.compute(wanted=True)
            maps[item.seq, item.solver] = made.maps.map.copy()
        frame = frames.get((item.run, item.frame))
        if frame is None:
            continue  # published before the listener came
        assert (frame.sequence, frame.map_sequence, frame.solver) == (item.seq, item.map_seq, item.solver)
        assert frame.host_ns["read"] == item.read_ns
        assert frame.device_us == item.device_us
        assert frame.touched == item.touched
        assert frame.gate_logit == item.gate_logit
        if item.solver == "none":
            assert not frame.map.any()
        elif (item.map_seq, item.solver) in maps:
            assert frame.map.tobytes() == maps[item.map_seq, item.solver].tobytes(), item.seq
            seen += frame.map.any()
    assert len(wire) > 50
    return seen


def is_made(item):
    return isinstance(item, WireFrame) and item.solver != "none" and item.map_seq == item.seq


def some(streams, condition):
    """Return what comes up to an item, and a few frames with a map of their own behind it."""
    found = until(streams, condition)
    for _ in range(8):
        found += until(streams, is_made)
    return found


def test_every_published_map_is_made_again_bit_by_bit(virtual_skin, running, tiny_path, tiny, tmp_path):
    with (
        virtual_skin(touches=[[0.5, 600, 0.3]], touches_wait=True, rate_hz=100.0, noise=3e-4) as port,
        running(port, tmp_path, bundle=tiny_path) as runtime,
        eitskin.subscribe_streams(runtime.publisher.endpoint) as streams,
    ):
        listener = Listener(runtime.publisher.endpoint)
        items = some(streams, is_made)
        reference = runtime.skin.reference.flat().voltages_V
        runtime.skin.set_cloud(CLOUD, RATIO * reference, reference)
        items += some(streams, lambda item: isinstance(item, Conditions) and item.cloud == 1)
        runtime.skin.set_cloud(None)
        items += some(streams, lambda item: isinstance(item, Conditions) and item.cloud == 2)
        runtime.skin.use_cloud(CLOUD, RATIO * reference, reference, is_fitted=True)
        items += some(streams, lambda item: isinstance(item, Conditions) and item.cloud == 3)
        digest = items[-1].reference if isinstance(items[-1], Conditions) else ""
        runtime.skin.recapture(5, force=True)
        items += until(streams, lambda item: isinstance(item, SkinState) and item.reference_sha256 != digest)
        items += until(streams, lambda item: isinstance(item, WireFrame) and item.frame)
        frames = listener.stop(max(item.frame or 0 for item in items if isinstance(item, WireFrame)))
    assert sum(streams.lost.values()) == streams.rejected == 0
    assert again(tiny, items, frames) > 0
    given = next(item for item in items if isinstance(item, CloudInUse) and item.revision == 1)
    assert given.cloud.tobytes() == CLOUD.astype("<f4").tobytes()
    assert given.predicted.tobytes() == (RATIO * reference).tobytes()
    assert given.predicted_flat.tobytes() == reference.tobytes()
    assert [item.why for item in items if isinstance(item, CloudInUse)][-1] == "fitted"
    assert given.why == "given"
    first = next(item for item in items if isinstance(item, WireFrame) and item.seq == given.seq)
    before = next(item for item in items if isinstance(item, WireFrame) and item.seq == given.seq - 1)
    assert (before.conditions, first.conditions) == (1, 2)


def test_drift_and_lost_electrodes_are_made_again_too(virtual_skin, running, tmp_path):
    """By a bundle that knows them, of voltages that begin as those of its flat sheet."""
    bundle = load_bundle()
    flat = bundle.consistency_arrays()["reference"]
    base = (1e-3 / np.abs(flat).max() * flat).tolist()
    with (
        virtual_skin(touches=[[2.5, 600, 0.1]], touches_wait=True, drift_per_s=0.004, base=base) as port,
        running(port, tmp_path, bundle=bundle) as runtime,
        eitskin.subscribe_streams(runtime.publisher.endpoint) as streams,
    ):
        listener = Listener(runtime.publisher.endpoint)
        items = until(streams, lambda item: isinstance(item, Conditions) and item.drift is not None)
        items += some(streams, is_made)
        runtime.skin.exclude((3, 9))
        items += some(streams, lambda item: isinstance(item, Conditions) and (9, "excluded", None) in item.electrodes)
        frames = listener.stop(max(item.frame or 0 for item in items if isinstance(item, WireFrame)))
    assert again(bundle, items, frames) >= 8
    lost = next(item for item in reversed(items) if isinstance(item, Conditions))
    assert len(lost.missing_rows) >= 40
    assert (lost.drift < 1.0).any()


def test_withheld_frames_are_told_too_and_what_happened_stands_in_the_state(virtual_skin, running, tmp_path):
    faults = ["frozen@1.0:0.4", "reset@2.0"]
    with (
        virtual_skin(rate_hz=100.0, noise=1e-2, faults=faults) as port,
        running(port, tmp_path) as runtime,
        eitskin.subscribe_streams(runtime.publisher.endpoint) as streams,
    ):
        listener = Listener(runtime.publisher.endpoint)
        items = until(streams, lambda item: isinstance(item, SkinState) and "device_reset" in str(item.events))
        items += until(streams, lambda item: isinstance(item, WireFrame) and not item.withheld)
        frames = listener.stop(max(item.frame or 0 for item in items if isinstance(item, WireFrame)))
    assert sum(streams.lost.values()) == 0
    wire = [item for item in items if isinstance(item, WireFrame)]
    assert [item.n for item in wire] == list(range(wire[0].n, wire[0].n + len(wire)))
    frozen = [item for item in wire if item.withheld == "frozen"]
    assert len(frozen) > 5
    for item in frozen:
        assert (item.frame, item.solver, item.map_seq, item.touched) == (None, "none", None, False)
        assert int.from_bytes(item.payload[8:12], "little") == item.seq % 2**32
        assert item.payload[20:] == frozen[0].payload[20:]
    assert {frame.sequence for frame in frames.values()}.isdisjoint({item.seq for item in frozen})
    assert sorted(wire, key=lambda item: item.read_ns) == wire
    events = [event for item in items if isinstance(item, SkinState) for event in item.events]
    published = {frame.sequence: frame for frame in frames.values()}
    for name in ("withheld:frozen", "device_reset"):
        (seq,) = {seq for seq, text in events if text == name}
        assert name in published[seq].events
    states = [item for item in items if isinstance(item, SkinState)]
    assert states[-1].status["withheld_by_reason"]["frozen"] == len(frozen)
    assert {item.reference for item in states} == {captured.stored(runtime.skin.reference)}
    assert states[-1].as_dict()["serial"] == "VIRTUAL-0001"
