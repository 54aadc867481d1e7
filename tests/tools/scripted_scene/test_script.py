"""The scripted scene: the same at every reading, as the forward model says, and true where it claims so."""

import numpy as np
import pytest

from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.scene import check_scene
from eitskin_sim.scene.shapes import Rect
from eitskin_tools.scripted_scene import choreography, keyframes
from eitskin_tools.scripted_scene.keyframes import Keyframes
from eitskin_tools.scripted_scene.script import demonstration, still

SCRIPT = demonstration()


@pytest.fixture(scope="module")
def shipped():
    name = keyframes.digest(SCRIPT.moments(SCRIPT.period_s), keyframes.MODEL)
    found = keyframes.load(name, keyframes.SHIPPED_FOLDER)
    assert found is not None, "solve what is shipped anew: python -m eitskin_tools.scripted_scene.script"
    return found


@pytest.fixture(scope="module")
def flat(shipped):
    return SCRIPT.voltages_at(0.0, shipped)


def test_a_script_is_the_same_at_every_reading_and_repeats():
    for time_s in (0.3, 2.71, 7.9, 12.5, 19.9):
        assert demonstration().scene_at(time_s) == SCRIPT.scene_at(time_s)
        again = SCRIPT.scene_at(time_s + 3 * SCRIPT.period_s)
        assert len(again.touches) == len(SCRIPT.scene_at(time_s).touches)
        assert SCRIPT.truth_at(time_s + 3 * SCRIPT.period_s) == pytest.approx(SCRIPT.truth_at(time_s), abs=1e-6)


def test_it_begins_flat_and_untouched_long_enough_for_a_reference():
    for time_s in np.arange(0.0, 1.75, 0.05):
        scene = SCRIPT.scene_at(time_s)
        assert scene.bend == Bend()
        assert scene.touches == ()


def test_every_moment_is_a_valid_scene_and_all_kinds_of_moment_occur():
    kinds = set()
    for count, time_s in enumerate(np.arange(0.0, SCRIPT.period_s, 0.1)):
        scene = SCRIPT.scene_at(time_s)
        kinds.add((scene.bend == Bend(), bool(scene.touches)))
        if count % 20 == 7:
            check_scene(scene)
    assert kinds == {(True, True), (True, False), (False, True), (False, False)}


@pytest.mark.parametrize("time_s", [2.7, 8.4, 12.65])
def test_keyframes_say_what_the_forward_model_says(shipped, flat, time_s):
    exact = keyframes.solve(SCRIPT.scene_at(time_s))
    found = SCRIPT.voltages_at(time_s, shipped)
    # Between pressed keyframes the interpolation leaves 2e-4 rms of V; float32 storage 1e-7. 50 dB noise is 3e-3.
    assert np.sqrt(np.mean((found / exact - 1.0) ** 2)) < 5e-4
    assert np.sqrt(np.mean((exact / flat - 1.0) ** 2)) > 0.02, "a moment at which nothing happens would prove nothing"


def test_a_held_scene_is_flat_and_untouched_first(tmp_path):
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


def test_a_damaged_cache_file_is_solved_anew_instead_of_read(tmp_path):
    frames = Keyframes(np.array([0.0, 1.0]), np.ones((2, 104)))
    keyframes.save("name", frames, tmp_path)
    assert keyframes.load("name", tmp_path).voltages.shape == (2, 104)
    path = tmp_path / "name.npz"
    path.write_bytes(path.read_bytes()[:100])
    assert keyframes.load("name", tmp_path) is None
