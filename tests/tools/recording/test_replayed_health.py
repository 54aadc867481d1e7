"""Played, a recording takes the drift out of frames, and does without electrodes, as the runtime did then."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eitskin
from eitskin import Conditions, Frame, WireFrame
from eitskin.model.bundle import Bundle, default_path, load_bundle
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.wire.frames import Frame as WireScan
from eitskin_tools.recording.codec import note_of
from eitskin_tools.recording.replay import Player, RecordedLine, ReplayOptions
from eitskin_tools.recording.script import Script, Step

from .conftest import PERIOD_NS, Taker, hello, play, recorded

FRAMES, REFERENCE, LOST_FROM, LOST = 300, 20, 150, 5
WITH_TIME = {"age_us", "latency_us", "host_ns", "counts"}
"""Of what is noted of a frame, what depends on clocks; the frames of the reference count as lost, too."""


def drifting(flat: np.ndarray) -> list[Step]:
    """Return frames of an untouched sheet that drifts by a percent, is touched for a while, and loses an electrode."""
    rng, found = np.random.default_rng(4), []
    size = 4e6 / np.abs(flat).max() * flat
    for index in range(FRAMES):
        factor = np.exp(-0.01 * index / FRAMES) * (1.0 + 0.1 * np.cos(np.arange(104)) * (80 <= index < 110))
        row = size * factor * (1.0 + 1e-4 * rng.standard_normal(104))
        if index >= LOST_FROM:
            row[rows_of((LOST,))] = 1e3 * rng.standard_normal(26)
        payload = WireScan(100 + index, 1000 + 5000 * index, np.rint(row).astype(np.int32)).pack()
        found.append(Step(WireFrame(payload, 100 + index, index * PERIOD_NS), 10**9 + index * PERIOD_NS))
    return found


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return load_bundle(default_path("units"))


@pytest.fixture(scope="module")
def drifted(bundle: Bundle) -> list[Any]:
    """All that streams and frames said, by a reference that was captured at the start."""
    arrays = bundle.consistency_arrays()
    if arrays is None:
        pytest.skip("the shipped bundle has no consistency.npz; 'eitskin export' makes one")
    steps, taker = drifting(np.asarray(arrays["reference"])), Taker()
    line = RecordedLine("test", hello(), lambda: iter(steps), paced=False)
    with eitskin.Skin(line, bundle=bundle) as skin:
        skin.capture_reference(REFERENCE)
        line.ended = skin.stop
        for _ in skin.publish(taker):
            pass
    return taker.items


def told(frame: Frame) -> dict[str, Any]:
    """Return all that a frame says but for clocks; null is equal to itself."""
    found = {name: value for name, value in note_of(frame).items() if name not in WITH_TIME}
    events = [event for event in found["events"] if event != "withheld:stale"]  # of a busy machine
    return {**found, "events": events, "gate_logit": round(found["gate_logit"], 12)}


def of(items: list[Any], kind: type) -> list[Any]:
    return [item for item in items if isinstance(item, kind)]


def test_the_recording_has_drift_a_lost_electrode_and_touches(drifted: list[Any]) -> None:
    conditions, frames = of(drifted, Conditions), of(drifted, Frame)
    assert sum(one.drift is not None for one in conditions) > 3
    assert any(electrode == LOST for one in conditions for electrode, *_ in one.electrodes)
    assert any(event.startswith("electrode:") for frame in frames for event in frame.events)
    assert 0 < sum(frame.map.any() for frame in frames) < len(frames)
    assert None not in {frame.drift_percent for frame in frames}


def test_a_program_sees_the_same_maps_drift_and_electrodes(tmp_path: Path, bundle: Bundle, drifted: list[Any]) -> None:
    recorded(tmp_path / "a.mcap", drifted)
    items = play(tmp_path / "a.mcap", bundle.path)
    then, again = of(drifted, Frame), of(items, Frame)
    assert len(then) > FRAMES - REFERENCE - 40  # those until the lost electrode is known are withheld
    assert [told(one) for one in again] == [told(one) for one in then]
    assert all(one.map.tobytes() == other.map.tobytes() for one, other in zip(again, then, strict=True))

    def streamed(found: list[Any]) -> list[Any]:
        by_revision = {one.revision: one for one in of(found, Conditions)}
        now = [by_revision[one.conditions] for one in of(found, WireFrame) if not one.withheld]
        return [(one.electrodes, None if one.drift is None else one.drift.tobytes(), one.gate_threshold) for one in now]

    assert streamed(items) == streamed(drifted)


def test_a_part_begins_with_the_drift_and_the_electrodes_of_then(
    tmp_path: Path, bundle: Bundle, drifted: list[Any]
) -> None:
    recorded(tmp_path / "a.mcap", drifted)
    script = Script(tmp_path / "a.mcap")
    begin_s = 1e-9 * (list(script.steps())[220].log_ns - script.first_ns)
    again = of(play(tmp_path / "a.mcap", bundle.path, from_s=begin_s), Frame)
    then = {frame.sequence: frame for frame in of(drifted, Frame)}
    assert 0 < len(again) <= 61
    for frame in again:
        other = then[frame.sequence]
        assert (frame.drift_percent, frame.electrodes) == (other.drift_percent, other.electrodes)
        assert frame.touched or frame.map.tobytes() == other.map.tobytes()


def test_an_electrode_can_be_excluded_while_it_plays(tmp_path: Path, bundle: Bundle, drifted: list[Any]) -> None:
    recorded(tmp_path / "a.mcap", drifted)
    taker = Taker()
    with Player(Script(tmp_path / "a.mcap"), ReplayOptions(paced=False), bundle=bundle.path) as player:
        player.skin.exclude((9,))
        for _ in player.skin.publish(taker):
            pass
    frames = of(taker.items, Frame)
    assert all("9:excluded:imputed" in frame.electrodes for frame in frames[1:])
    assert any(len(frame.electrodes) == 2 for frame in frames)
    assert sum("electrode:9:excluded:imputed" in frame.events for frame in frames) == 1
