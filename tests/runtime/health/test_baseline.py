"""The untouched sheet is followed from look to look; a touch, however long it is held, is none of it."""

import numpy as np
import pytest

from eitskin.health.baseline import UntouchedBaseline
from eitskin_proto.sensor.table import N_ROWS

NOISE = 0.00316
FRAMES = 24
COMMON = np.ones(N_ROWS)
PRESS = np.random.default_rng(1).standard_normal(N_ROWS) ** 3
PRESS = 0.02 * (PRESS - PRESS.mean() + 0.5 * PRESS.std()) / PRESS.std()
"""Two percent rms, and half of that in all rows alike."""


class Sheet:
    """Reads a sheet with noise, look after look."""

    def __init__(self, noise=NOISE, *, known=True, seed=0):
        self.rng, self.noise = np.random.default_rng(seed), noise
        self.resting = UntouchedBaseline()
        self.resting.start(np.full(N_ROWS, noise), 100, known=known)
        self.own = noise / 10 * self.rng.standard_normal(N_ROWS)  # of the reference

    def show(self, logs, looks, touched=False, frames=FRAMES):
        for _ in range(looks):
            noise = self.noise / np.sqrt(frames) * self.rng.standard_normal(N_ROWS)
            self.resting.add(self.own + logs + noise, frames, touched=touched)
        return self.resting


@pytest.mark.parametrize("step", [0.1, -0.1, 0.004])
@pytest.mark.parametrize("noise", [NOISE, 0.0005])
def test_a_common_change_is_taken_over_however_quick(step, noise):
    resting = Sheet(noise).show(step * COMMON, 40)
    assert resting.known
    assert resting.common == pytest.approx(step, abs=1e-3)


def test_slow_drift_is_followed_uneven_as_it_is():
    sheet, uneven = Sheet(), 0.004 * np.linspace(-1.7, 1.7, N_ROWS)
    for part in np.linspace(0.0, 1.0, 3000):
        sheet.show(0.02 * part * COMMON + part * uneven, 1)
    resting = sheet.show(0.02 * COMMON + uneven, 1000)
    assert resting.known
    assert resting.common == pytest.approx(0.02, abs=3e-4)
    assert resting.uneven == pytest.approx(0.0039, abs=4e-4)
    np.testing.assert_allclose(resting.drift - sheet.own, 0.02 + uneven, atol=2e-3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_touch_held_for_an_hour_stays_a_touch_though_the_gate_sleeps(sign):
    sheet = Sheet()
    sheet.show(0.0 * COMMON, 300)
    before = sheet.resting.drift
    resting = sheet.show(sign * 0.3 * PRESS, 3000, frames=120)
    sheet.show(sign * 0.3 * PRESS + 0.02 * COMMON, 3000, frames=120)
    assert not resting.known
    assert resting.left >= 3600 * 200 - 120
    np.testing.assert_array_equal(resting.drift, before)


def test_a_released_sheet_is_known_again_with_what_drifted_meanwhile():
    sheet = Sheet()
    sheet.show(0.0 * COMMON, 100)
    sheet.show(PRESS, 500, touched=True)
    resting = sheet.show(0.01 * COMMON, 40)
    assert resting.known
    assert resting.common == pytest.approx(0.01, abs=5e-4)


def test_what_a_press_leaves_behind_is_taken_over_and_told():
    sheet, press = Sheet(), 4.0 * PRESS
    sheet.show(0.0 * COMMON, 100)
    sheet.show(press, 100, touched=True)
    resting = sheet.show(0.04 * press, 60)
    assert resting.known
    assert resting.after_effect == pytest.approx(0.04, abs=0.005)
    np.testing.assert_allclose(resting.drift - sheet.own, 0.04 * press, atol=2e-3)
    sheet.show(0.0 * COMMON, 100)
    assert resting.known
    assert abs(resting.after_effect) < 0.005


def test_drift_and_a_touch_together_are_no_common_change():
    cold = Sheet(known=False)
    assert not cold.show(0.1 * COMMON + 0.5 * PRESS, 300).known
    assert cold.show(0.1 * COMMON, 300).known
    assert cold.resting.common == pytest.approx(0.1, abs=1e-3)


def test_rows_that_are_filled_in_say_nothing():
    sheet, gone = Sheet(), np.zeros(N_ROWS, dtype=np.bool_)
    gone[:26] = True
    sheet.show(0.0 * COMMON, 100)
    sheet.resting.leave_out(gone)
    resting = sheet.show(0.01 * COMMON + 0.5 * gone, 100)
    assert resting.known
    assert resting.common == pytest.approx(0.01, abs=5e-4)
    resting.leave_out(np.zeros(N_ROWS, dtype=np.bool_))
    assert sheet.show(0.01 * COMMON, 100).known
    assert resting.common == pytest.approx(0.01, abs=5e-4)
