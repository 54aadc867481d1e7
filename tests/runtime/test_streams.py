"""What was measured, from a virtual skin to a subscriber: enough to make every published map again, bit by bit."""

import itertools
import threading
import time

import numpy as np

import eitskin
from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
from eitskin.messaging.streams.state import SkinState
from eitskin.pipeline.maps_again import MapsAgain
from eitskin.reference import captured
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.wire.answers import Hello

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
    made, maps, seen, now = MapsAgain(bundle, hello.volts_per_count), {}, 0, None
    for item in items:
        if not isinstance(item, WireFrame) or item.frame is None:
            continue
        assert item.withheld == ""
        found = conditions[item.conditions]
        if found is not now:
            if now is None or found.reference != now.reference:
                made.use_reference(captured.parsed(references[found.reference], "it", "none"))
            if now is None or found.cloud != now.cloud:
                made.use_cloud(clouds[found.cloud])
            made.use_conditions(found)
            now = found
        if item.solver != "none" and item.map_seq == item.seq:
            maps[item.seq, item.solver] = made.map_of(item.payload, item.solver)
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


def test_every_published_map_is_made_again_bit_by_bit(virtual_skin, running, tiny_path, tiny, tmp_path):
    with (
        virtual_skin(touches=[[0.1, 600, 0.3]], rate_hz=100.0, noise=3e-4) as port,
        running(port, tmp_path, bundle=tiny_path, skip_unchanged=True) as runtime,
        eitskin.subscribe_streams(runtime.publisher.endpoint) as streams,
    ):
        listener = Listener(runtime.publisher.endpoint)
        items = until(streams, lambda item: isinstance(item, WireFrame) and item.solver != "none")
        reference = runtime.skin.reference.flat().voltages_V
        runtime.skin.set_cloud(CLOUD, RATIO * reference, reference)
        items += until(streams, lambda item: isinstance(item, Conditions) and item.cloud == 1)
        runtime.skin.set_cloud(None)
        items += until(streams, lambda item: isinstance(item, Conditions) and item.cloud == 2)
        runtime.skin.recapture(5, force=True)
        digest = items[-1].reference
        items += until(streams, lambda item: isinstance(item, SkinState) and item.reference_sha256 != digest)
        items += until(streams, lambda item: isinstance(item, WireFrame) and item.frame, most=500)
        items += list(itertools.islice(streams, 100))
        last = max(item.frame or 0 for item in items if isinstance(item, WireFrame))
        frames = listener.stop(last)
    assert sum(streams.lost.values()) == streams.rejected == 0
    assert again(tiny, items, frames) > 30
    given = next(item for item in items if isinstance(item, CloudInUse) and item.revision == 1)
    assert given.cloud.tobytes() == CLOUD.astype("<f4").tobytes()
    assert given.predicted.tobytes() == (RATIO * reference).tobytes()
    assert given.predicted_flat.tobytes() == reference.tobytes()
    assert given.why == "given"
    first = next(item for item in items if isinstance(item, WireFrame) and item.seq == given.seq)
    assert first.read_ns >= given.taken_ns
    before = next(item for item in items if isinstance(item, WireFrame) and item.seq == given.seq - 1)
    assert (before.conditions, first.conditions) == (1, 2)
