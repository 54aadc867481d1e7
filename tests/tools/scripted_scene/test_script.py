"""The scripted scene: the same at every reading, as the forward model says, and true where it claims so."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.skin.cloud import check_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.scene import check_scene
from eitskin_sim.scene.shapes import Rect
from eitskin_tools.scripted_scene import choreography, keyframes
from eitskin_tools.scripted_scene.keyframes import Keyframes
from eitskin_tools.scripted_scene.script import demonstration, from_scene, still

SCRIPT = demonstration()


@pytest.fixture(scope="module")
def shipped() -> Keyframes:
    name = keyframes.digest(SCRIPT.moments(SCRIPT.period_s), keyframes.MODEL)
    found = keyframes.load(name, keyframes.SHIPPED)
    assert found is not None, "solve what is shipped anew: python -m eitskin_tools.scripted_scene.script"
    return found


@pytest.fixture(scope="module")
def flat(shipped: Keyframes) -> np.ndarray:
    return SCRIPT.voltages_at(0.0, shipped)


def test_a_script_is_the_same_at_every_reading_and_repeats() -> None:
    for time_s in (0.3, 2.71, 7.9, 12.5, 19.9):
        assert demonstration().scene_at(time_s) == SCRIPT.scene_at(time_s)
        again = SCRIPT.scene_at(time_s + 3 * SCRIPT.period_s)
        assert len(again.touches) == len(SCRIPT.scene_at(time_s).touches)
        assert SCRIPT.truth_at(time_s + 3 * SCRIPT.period_s) == pytest.approx(SCRIPT.truth_at(time_s), abs=1e-6)


def test_it_begins_flat_and_untouched_long_enough_for_a_reference() -> None:
    for time_s in np.arange(0.0, 1.75, 0.05):
        scene = SCRIPT.scene_at(time_s)
        assert scene.bend == Bend()
        assert scene.touches == ()


def test_every_moment_is_a_valid_scene_and_all_kinds_of_moment_occur() -> None:
    kinds = set()
    for count, time_s in enumerate(np.arange(0.0, SCRIPT.period_s, 0.1)):
        scene = SCRIPT.scene_at(time_s)
        kinds.add((scene.bend == Bend(), bool(scene.touches)))
        if count % 20 == 7:
            check_scene(scene)
    assert kinds == {(True, True), (True, False), (False, True), (False, False)}


def test_the_truth_holds_the_area_of_the_touches() -> None:
    for time_s in np.arange(0.0, SCRIPT.period_s, 0.37):
        area = sum(shape.area_mm2 for touch in SCRIPT.scene_at(time_s).touches for shape in touch.shapes)
        # float32 pixels: 1e-7 of the map's 15,000 mm2
        assert SCRIPT.truth_at(time_s).sum() * PAPER.grid.pitch_mm**2 == pytest.approx(area, abs=1e-2)


def test_clouds_are_clouds_and_a_flat_sheet_gives_the_flat_one() -> None:
    check_cloud(SCRIPT.cloud_at(8.0))
    assert SCRIPT.cloud_at(0.5)[2] == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(SCRIPT.cloud_at(8.5)[2]) > 10.0


def test_scanner_noise_repeats_with_its_seed() -> None:
    first, second = (SCRIPT.cloud_at(8.0, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, SCRIPT.cloud_at(8.0))


@pytest.mark.parametrize("time_s", [2.7, 8.4, 12.65])
def test_keyframes_say_what_the_forward_model_says(shipped: Keyframes, flat: np.ndarray, time_s: float) -> None:
    exact = keyframes.solve(SCRIPT.scene_at(time_s))
    found = SCRIPT.voltages_at(time_s, shipped)
    # Between pressed keyframes the interpolation leaves 2e-4 rms of V; float32 storage 1e-7. 50 dB noise is 3e-3.
    assert np.sqrt(np.mean((found / exact - 1.0) ** 2)) < 5e-4
    assert np.sqrt(np.mean((exact / flat - 1.0) ** 2)) > 0.02, "a moment at which nothing happens would prove nothing"


def test_a_touch_that_is_being_pressed_is_interpolated_to_a_tenth_of_the_noise(shipped: Keyframes) -> None:
    times = shipped.times_s
    middles = np.array([(a + b) / 2 for a, b in itertools.pairwise(times) if 5.4 <= a < b <= 5.56])[[1, 3]]
    errors = [shipped.at(at) / keyframes.solve(SCRIPT.scene_at(at)) - 1.0 for at in middles.tolist()]
    assert np.sqrt(np.mean(np.square(errors))) < 1e-3  # 6e-4 was measured; 50 dB noise is 3e-3


def test_a_keyframe_left_out_is_noticed(shipped: Keyframes) -> None:
    """The bound above must fail where keyframes are too far apart: half a second here."""
    inside = (shipped.times_s >= 7.0) & (shipped.times_s <= 8.0)
    sparse = Keyframes(shipped.times_s[inside][[0, -1]], shipped.voltages[inside][[0, -1]])
    exact = SCRIPT.voltages_at(7.5, shipped)
    assert np.sqrt(np.mean((sparse.at(7.5) / exact - 1.0) ** 2)) > 2e-3


def test_voltages_jump_where_a_touch_comes_and_nowhere_else(shipped: Keyframes, flat: np.ndarray) -> None:
    def change(time_s: float) -> float:
        pair = [SCRIPT.voltages_at(time_s + side * 1e-4, shipped) for side in (-1, 1)]
        return float(np.sqrt(np.mean(((pair[1] - pair[0]) / flat) ** 2)))

    assert change(1.8) > 0.01
    assert change(4.6) > 0.01
    assert change(3.0) < 1e-3
    assert change(8.0) < 1e-3


def test_bending_alone_changes_the_voltages_more_than_noise(shipped: Keyframes, flat: np.ndarray) -> None:
    bent = SCRIPT.voltages_at(10.2, shipped)
    assert SCRIPT.scene_at(10.2).touches == ()
    assert np.sqrt(np.mean(relative_change(bent, flat) ** 2)) > 0.05


def test_a_held_scene_is_flat_and_untouched_first(tmp_path: Path) -> None:
    scene = Scene(bend=Bend(angle_deg=60.0, stretch_along=1.05), touches=(Touch((Rect(40.0, 40.0, 50.0, 50.0),)),))
    script = still(scene)
    assert script.scene_at(1.0).touches == ()
    assert script.scene_at(1.0).bend == Bend()
    assert script.scene_at(1e4).bend == scene.bend
    moments = script.moments(100.0)
    assert len({moment.scene for moment in moments}) == 2
    values = {moment.scene: float(len(moment.scene.touches)) for moment in moments}
    frames = Keyframes(
        np.array([m.time_s for m in moments]), np.array([[1.0 + values[m.scene]] * 104 for m in moments])
    )
    assert script.voltages_at(1.7, frames)[0] == 1.0
    assert script.voltages_at(choreography.UNTOUCHED_FLAT_S, frames)[0] == 2.0
    assert script.voltages_at(500.0, frames)[0] == 2.0


def test_a_scene_file_is_read_strictly(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    path.write_text('{"touches": [{"disc_mm": [75, 50, 8]}]}')
    assert from_scene(path).scene_at(5.0).touches[0].shapes[0].area_mm2 == pytest.approx(np.pi * 64)
    path.write_text('{"touch": []}')
    with pytest.raises(ValueError, match="unknown key 'touch'"):
        from_scene(path)


def test_rows_that_change_sign_are_interpolated_linearly() -> None:
    frames = Keyframes(np.array([0.0, 1.0]), np.array([[1.0, -2.0], [-1.0, -8.0]]))
    assert frames.at(0.5) == pytest.approx([0.0, -4.0])


def test_a_changed_script_or_model_has_another_digest() -> None:
    moments = SCRIPT.moments(3.0)
    assert keyframes.digest(moments, "a") != keyframes.digest(moments, "b")
    assert keyframes.digest(moments, "a") != keyframes.digest(moments[:-1], "a")
    assert keyframes.digest(moments, "a") == keyframes.digest(demonstration().moments(3.0), "a")


def test_a_damaged_cache_file_is_solved_anew_instead_of_read(tmp_path: Path) -> None:
    frames = Keyframes(np.array([0.0, 1.0]), np.ones((2, 104)))
    keyframes.save("name", frames, tmp_path)
    assert keyframes.load("name", tmp_path).voltages.shape == (2, 104)
    path = tmp_path / "name.npz"
    path.write_bytes(path.read_bytes()[:100])
    assert keyframes.load("name", tmp_path) is None
