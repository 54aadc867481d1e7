"""A common factor is found, reported and, if asked for, taken out; a touch is none."""

import numpy as np
import pytest

from eitskin.health.drift import HOLD, LEAST, SLOPE, Drift
from eitskin.health.imputation import Consistency
from eitskin_proto.sensor.table import N_ROWS

CAUSES = 0.1 * np.random.default_rng(11).standard_normal((6, N_ROWS))
BENDS = 0.05 * np.random.default_rng(12).standard_normal((4, N_ROWS))
NOISE = 0.003

NO_PREDICTION = np.zeros(N_ROWS, dtype=np.float32)
PREDICTION = np.full(N_ROWS, 1e-6, dtype=np.float32)


def consistency():
    """Return an untouched sheet of four bends, known to a hundredth where there is a prediction."""
    noise, zero = NOISE**2 * np.eye(N_ROWS), np.zeros(N_ROWS)
    return Consistency(
        mean=zero,
        covariance=CAUSES.T @ CAUSES + noise,
        ratio_range=np.array([0.01, 8.0]),
        reference=np.ones(N_ROWS),
        untouched_mean=zero,
        untouched_covariance=BENDS.T @ BENDS + noise,
        predicted_mean=zero,
        predicted_covariance=1e-4 * BENDS.T @ BENDS + noise,
        drift_limits=np.array([[0.02, 3.0], [0.002, 3.0]]),
        projection_inverse=np.eye(N_ROWS),
        thresholds=np.array([30.0, 5.0]),
    )


def frames(logs, count, seed=0):
    noise = NOISE * np.random.default_rng(seed).standard_normal((count, N_ROWS))
    return np.expm1(logs + noise).astype(np.float32)


def show(drift, shown, predicted, touched=False):
    return [number for number, frame in enumerate(shown) if drift.look(frame, predicted, touched=touched)]


@pytest.mark.parametrize("true", [-0.2, 0.1, 0.4])
@pytest.mark.parametrize("predicted", [NO_PREDICTION, PREDICTION])
def test_a_common_factor_is_found_whatever_the_bend(true, predicted):
    drift = Drift(consistency())
    bend = np.array([1.0, -0.5, 0.3, 0.2]) @ BENDS * (0.01 if predicted.any() else 1.0)
    told = show(drift, frames(true + bend, HOLD + 100), predicted)
    assert len(told) == 1
    assert told[0] >= HOLD - 1
    # Half a percent: the mean of 50 frames of 0.3 %, and what four bends hide of a constant over 104 rows.
    assert drift.percent == pytest.approx(100 * np.expm1(true), abs=1.5)


def test_a_sheet_without_drift_tells_nothing():
    drift = Drift(consistency())
    assert show(drift, frames(0.5 * BENDS[0], HOLD + 200), NO_PREDICTION) == []
    assert abs(drift.percent) < 100 * LEAST


def test_nothing_is_said_while_the_sheet_is_touched():
    drift = Drift(consistency(), compensate=True)
    assert show(drift, frames(0.1 + CAUSES[0], HOLD + 200), PREDICTION, touched=True) == []
    assert np.isnan(drift.percent)
    assert drift.taken_out == 0.0


def test_compensation_takes_out_the_factor_slowly_and_a_touch_stays():
    drift = Drift(consistency(), compensate=True)
    drifted = frames(np.full(N_ROWS, 0.01), HOLD + 1500)
    show(drift, drifted, PREDICTION)
    assert 0 < drift.taken_out <= 1500 * SLOPE + 1e-9
    assert drift.taken_out == pytest.approx(0.01, abs=1e-3)
    before = drift.taken_out
    touch = np.expm1(0.01 + 0.5 * CAUSES[1]).astype(np.float32)
    show(drift, frames(0.01 + 0.5 * CAUSES[1], 3000, seed=4), PREDICTION, touched=True)
    assert drift.taken_out == pytest.approx(before, abs=2 * SLOPE * 50)  # at most until the average shows the touch
    drift.correct(touch)
    np.testing.assert_allclose(np.log1p(touch), 0.5 * CAUSES[1], atol=2e-3)


def test_without_a_prediction_nothing_is_taken_out():
    drift = Drift(consistency(), compensate=True)
    show(drift, frames(np.full(N_ROWS, 0.1), HOLD + 200), NO_PREDICTION)
    assert drift.percent == pytest.approx(10.5, abs=1.5)
    assert drift.taken_out == 0.0


def test_a_new_reference_begins_anew():
    drift = Drift(consistency(), compensate=True)
    show(drift, frames(np.full(N_ROWS, 0.1), HOLD + 200), PREDICTION)
    drift.restart()
    assert drift.taken_out == 0.0
    assert np.isnan(drift.percent)


GRADIENT = np.linspace(-0.05, 0.05, N_ROWS)


def test_an_untouched_sheet_that_no_factor_explains_is_called_uneven_once():
    drift = Drift(consistency())
    assert show(drift, frames(np.full(N_ROWS, 0.1), HOLD + 50), PREDICTION) == [HOLD - 1]
    told = show(drift, frames(GRADIENT, HOLD + 100), PREDICTION)
    assert len(told) == 1
    assert HOLD - 1 <= told[0] < HOLD + 60  # the running mean first has to leave the uniform drift
    assert drift.uneven
    assert np.isnan(drift.percent), "no number stands for it"
    show(drift, frames(np.zeros(N_ROWS), 300), PREDICTION)
    assert not drift.uneven


@pytest.mark.parametrize(("predicted", "touched"), [(PREDICTION, True), (NO_PREDICTION, False)])
def test_what_may_be_a_touch_or_a_bend_is_not_called_uneven(predicted, touched):
    drift = Drift(consistency())
    assert show(drift, frames(GRADIENT, 2 * HOLD), predicted, touched=touched) == []
    assert not drift.uneven
