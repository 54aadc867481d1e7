"""A part of a recording, played: each frame is as touched as it was, although what lay before the part is not there."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eitskin
from eitskin import Frame, WireFrame
from eitskin.model.bundle import Bundle, default_path, load_bundle
from eitskin.model.gate import Gate
from eitskin_proto.wire.frames import Frame as WireScan
from eitskin_tools.recording.replay import RecordedLine
from eitskin_tools.recording.script import Script, Step

from ..conftest import PERIOD_NS, Taker, hello, play, recorded

FRAMES, REFERENCE, PRESS, GONE = 400, 20, 120, 360
STRENGTH = 3.0
"""Of the press, in the gate's filters: the single frame shows no touch below a limit of about 4."""


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return load_bundle(default_path("units"))


def press(bundle: Bundle) -> np.ndarray:
    """Return the (104,) factors of a press that its gate sees by the change alone."""
    arrays = bundle.gate_arrays()
    assert arrays is not None
    gate = Gate(arrays)
    assert gate.filters is not None
    first, whitened = gate._first[:-1].astype(float), gate.filters.whitened
    whitening, filters = first[:, :whitened], first[:, whitened:]
    patterns = np.linalg.pinv(whitening) @ filters
    logarithms = np.linalg.pinv(whitening.T) @ (STRENGTH * patterns)
    gentlest = np.abs(logarithms).max(axis=0).argmin()
    return np.asarray(np.exp(logarithms[:, gentlest]))


def steps(bundle: Bundle) -> list[Step]:
    """Return frames of a flat sheet with a faint press from ``PRESS`` to ``GONE``."""
    arrays = bundle.consistency_arrays()
    if arrays is None:
        pytest.skip("the shipped bundle has no consistency.npz; 'eitskin export' makes one")
    flat = np.asarray(arrays["reference"])
    flat, rng, factors, found = 2e9 / np.abs(flat).max() * flat, np.random.default_rng(4), press(bundle), []
    for index in range(FRAMES):
        row = flat * (factors if PRESS <= index < GONE else 1.0) * (1.0 + 1e-5 * rng.standard_normal(104))
        payload = WireScan(100 + index, 1000 + 5000 * index, np.rint(row).astype(np.int32)).pack()
        found.append(Step(WireFrame(payload, 100 + index, index * PERIOD_NS), 10**9 + index * PERIOD_NS))
    return found


@pytest.fixture(scope="module")
def pressed(bundle: Bundle) -> list[Any]:
    taker, frames = Taker(), steps(bundle)
    line = RecordedLine("test", hello(), lambda: iter(frames), paced=False)
    with eitskin.Skin(line, bundle=bundle, skip_unchanged=True) as skin:
        skin.capture_reference(REFERENCE)
        line.ended = skin.stop
        for _ in skin.publish(taker):
            pass
    return taker.items


def of(items: list[Any]) -> dict[int, Frame]:
    return {item.sequence: item for item in items if isinstance(item, Frame)}


def test_the_press_is_one_that_only_the_frames_before_it_show(pressed: list[Any], bundle: Bundle) -> None:
    frames, threshold = of(pressed), load_bundle(bundle.path).gate_arrays()
    assert threshold is not None
    there = [frame for seq, frame in frames.items() if 100 + PRESS + 5 <= seq < 100 + GONE]
    assert all(frame.touched for frame in there)
    assert not any(frame.touched for seq, frame in frames.items() if seq < 100 + PRESS)
    assert sum(frame.gate_logit > float(threshold["threshold"].reshape(-1)[0]) for frame in there) < 0.1 * len(there)
    assert len({frame.map_sequence for frame in there}) < 0.9 * len(there), "maps are kept"


@pytest.mark.parametrize("wire_only", [False, True])
def test_a_part_that_begins_under_a_faint_press_shows_it_from_its_first_frame(
    tmp_path: Path, bundle: Bundle, pressed: list[Any], *, wire_only: bool
) -> None:
    recorded(tmp_path / "a.mcap", [item for item in pressed if not (wire_only and isinstance(item, Frame))])
    script, then = Script(tmp_path / "a.mcap"), of(pressed)
    log_ns = [step.log_ns for step in script.steps()]
    begin_s = 1e-9 * (log_ns[PRESS + 40 - REFERENCE] - script.first_ns)
    again = of(play(tmp_path / "a.mcap", bundle.path, from_s=begin_s))
    assert len(again) > 100
    assert [frame.touched for frame in again.values()] == [then[seq].touched for seq in again]
    assert next(iter(again.values())).touched
    anew = {seq: frame for seq, frame in again.items() if then[seq].map_sequence - then[seq].fused + 1 in again}
    assert len(anew) > 60, "but for those whose maps rest on frames before the part"
    assert [frame.map.tobytes() for frame in anew.values()] == [then[seq].map.tobytes() for seq in anew]
    touched = {seq for seq in anew if then[seq].solver != "none"}
    assert len(touched) > 30
    assert [again[seq].map_sequence for seq in touched] == [then[seq].map_sequence for seq in touched]


def test_the_untouched_frames_whose_maps_were_computed_are_those_of_then(
    tmp_path: Path, bundle: Bundle, pressed: list[Any]
) -> None:
    """Which ones they are hangs on how many untouched frames came before, which a part of the recording lacks."""
    recorded(tmp_path / "a.mcap", pressed)
    script, then = Script(tmp_path / "a.mcap"), of(pressed)
    begin_s = 1e-9 * ([step.log_ns for step in script.steps()][20] - script.first_ns)
    part = of(play(tmp_path / "a.mcap", bundle.path, from_s=begin_s))
    again = {  # but for touched frames that had the map of a frame before the part
        seq: frame for seq, frame in part.items() if then[seq].solver == "none" or then[seq].map_sequence in part
    }
    assert len(again) > 100
    assert [frame.skipped for frame in again.values()] == [then[seq].skipped for seq in again]
    assert any("map:untouched" in frame.skipped for frame in again.values())


@pytest.mark.process
@pytest.mark.slow
def test_what_is_played_is_verified_where_that_is_asked_for(tmp_path: Path, pressed: list[Any]) -> None:
    """A robot that waits for verdicts gets them of a recording, too."""
    recorded(tmp_path / "a.mcap", pressed)
    where = ["--publish", f"ipc://{tmp_path}/f", "--control", f"ipc://{tmp_path}/c"]
    words = ["replay", str(tmp_path / "a.mcap"), "--verify", "always", "--loop", "--speed", "0.05", "--quiet", *where]
    with subprocess.Popen(
        [sys.executable, "-m", "eitskin_tools.cli", *words], stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        try:
            assert process.stderr.readline().startswith("ready")
            with eitskin.subscribe_verified(where[1], "all", timeout_s=60.0) as verdicts:
                found = next(one for one in verdicts if one.p_value is not None)
            assert found.touches is not None
        finally:
            process.terminate()
            process.communicate(timeout=60)
