"""What the forward model says of touches bears out what drift is told from them by (eitskin.health.baseline)."""

import numpy as np
import pytest

from eitskin.health.baseline import MAX_UNEVEN, MAX_UNEVEN_RATIO, UntouchedBaseline
from eitskin.health.drift import MAX_SCAN_D, MIN_COMMON, Drift
from eitskin.health.imputation import Consistency
from eitskin.health.untouched import Untouched
from eitskin.model.bundle import default_path, load_bundle
from eitskin_proto.sensor.table import N_ROWS
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.shapes import Disc

pytestmark = pytest.mark.slow

ELEMENT_MM = 6.0
BENDS = (Bend(), Bend(angle_deg=60.0))

TOGETHER, LONG_TOGETHER = 24, 480
"""Frames that the drift's estimate sees at once: as in the runtime, and while a touch lies still."""

UNTOUCHED, HOUR = 300, 720_000
"""Looks before the touch, 36 s at 200 frames/s, and frames that it lies still."""


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
        assert found.rms > 3.0 * MAX_UNEVEN_RATIO * abs(found.common), contrast
        assert found.rms > 1.5 * MAX_UNEVEN, contrast


def test_a_touch_that_a_clean_scan_hides_moves_less_than_what_is_taken_from_scans(touches, consistency):
    model = Untouched.of(consistency, predicted=True)
    for contrast, logs in touches:
        common, distance = model.estimate(logs)
        faint = 0.8 < contrast < 1.5  # beside random devices little is left of those to tell them by
        assert distance > MAX_SCAN_D or abs(common) < (2.0 * MIN_COMMON if faint else 0.6 * MIN_COMMON), contrast


def share_taken_out(consistency, logs, noise, looks, rng):
    """Return the share of a touch that drift takes out, after it came on within some looks and lay for an hour."""
    drift = Drift(consistency)
    drift.restart(np.full(len(logs), noise), 100, fresh=True)
    own = noise / 10.0 * rng.standard_normal(len(logs))

    def show(shown, frames):
        mean = np.expm1(own + shown + noise / np.sqrt(frames) * rng.standard_normal(len(logs))).astype(np.float32)
        drift.update(np.broadcast_to(mean, (frames, len(logs))), np.zeros(N_ROWS, np.float32), touched=False)

    for _ in range(UNTOUCHED):
        show(0.0, TOGETHER)
    before = drift.resting.drift
    for look in range(looks):
        show(logs * (look + 1) / looks, TOGETHER)
    for _ in range(HOUR // LONG_TOGETHER):
        show(logs, LONG_TOGETHER)
    return float(np.sqrt(np.mean((drift.resting.drift - before) ** 2) / np.mean(logs**2)))


def test_a_touch_held_for_an_hour_is_not_learned_at_any_noise(touches, consistency):
    rng = np.random.default_rng(0)
    for noise, most in ((0.0032, 0.05), (0.035, 0.15)):  # 50 and 29 dB
        for contrast, logs in touches[6:9:2]:
            assert share_taken_out(consistency, logs, noise, 1, rng) < 0.01, (contrast, noise)
            assert share_taken_out(consistency, logs, noise, 400, rng) < most, (contrast, noise)
