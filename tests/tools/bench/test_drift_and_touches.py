"""What the forward model says of touches bears out what drift is told from them by (eitskin.health.baseline)."""

import numpy as np
import pytest
from tests.tools.studies.study import study

from eitskin.health.baseline import MOST_UNEVEN, PART, UntouchedBaseline
from eitskin.health.drift import CLEAN, LEAST
from eitskin.health.imputation import Consistency
from eitskin.health.untouched import Untouched
from eitskin.model.bundle import default_path, load_bundle
from eitskin_proto.sensor.table import N_ROWS
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.shapes import Disc

taken = study("drift").taken

ELEMENT_MM = 6.0
BENDS = (Bend(), Bend(angle_deg=60.0))


@pytest.fixture(scope="module")
def touches():
    """(contrast, (104,) log of what a touch of 16 or 25 mm does): both signs, flat and bent, at drawn places."""
    rng, found = np.random.default_rng(3), []
    for bend in BENDS:
        untouched = factorise_scene(Scene(bend=bend, element_size_mm=ELEMENT_MM)).voltages()
        for contrast in (0.2, 0.6, 0.85, 1.2, 2.0, 200.0):
            for size_mm in (16.0, 25.0):
                x, y = rng.uniform(size_mm / 2, [150.0 - size_mm / 2, 100.0 - size_mm / 2])
                disc = Disc(float(x), float(y), size_mm / 2)
                touch = Touch((disc,), contrast=contrast, border_mm=0.0 if contrast > 1 else 4.0)
                volts = factorise_scene(Scene(bend=bend, touches=(touch,), element_size_mm=ELEMENT_MM)).voltages()
                found.append((contrast, np.log(volts / untouched)))
    return found


@pytest.fixture(scope="module")
def consistency():
    arrays = load_bundle(default_path()).consistency_arrays()
    assert arrays is not None
    return Consistency.of(arrays)


@pytest.mark.parametrize("noise", [np.full(N_ROWS, 0.003), np.geomspace(1e-3, 1.0, N_ROWS)])
def test_no_touch_moves_all_rows_alike(touches, noise):
    resting = UntouchedBaseline()
    resting.start(noise, 100, known=True)
    for contrast, logs in touches:
        found = resting.split(logs, 1.0)
        assert found.rms > 3.0 * PART * abs(found.common), contrast
        assert found.rms > 1.5 * MOST_UNEVEN, contrast


def test_a_touch_that_a_clean_scan_hides_moves_less_than_what_is_taken_from_scans(touches, consistency):
    model = Untouched.of(consistency, predicted=True)
    for contrast, logs in touches:
        common, distance = model.estimate(logs)
        faint = 0.8 < contrast < 1.5  # beside random devices little is left of those to tell them by
        assert distance > CLEAN or abs(common) < (2.0 * LEAST if faint else 0.6 * LEAST), contrast


def test_a_touch_held_for_an_hour_is_not_learned_at_any_noise(touches, consistency):
    rng = np.random.default_rng(0)
    for noise, most in ((0.0032, 0.05), (0.035, 0.15)):  # 50 and 29 dB
        for contrast, logs in touches[6:9:2]:
            assert taken(consistency, logs, noise, 1, rng) < 0.01, (contrast, noise)
            assert taken(consistency, logs, noise, 400, rng) < most, (contrast, noise)
