"""How far the sheet is from its reference is told and taken out: by rest, by a scan, and never by a touch."""

import math

import numpy as np
import pytest

from eitskin.health.drift import CAPTURE_PRIOR, COMMON_WALK, FILE_PRIOR, MIN_COMMON, REST_FRAMES, Drift
from eitskin.health.imputation import Consistency
from eitskin_proto.sensor.table import N_ROWS

CAUSES = 0.1 * np.random.default_rng(11).standard_normal((6, N_ROWS))
BENDS = 0.05 * np.random.default_rng(12).standard_normal((4, N_ROWS))
NOISE = 0.003
TOGETHER = 24

NO_PREDICTION = np.zeros(N_ROWS, dtype=np.float32)
PREDICTION = np.full(N_ROWS, 1e-6, dtype=np.float32)


def consistency():
    """Return an untouched sheet of four bends, known to a tenth where there is a prediction."""
    noise, zero = NOISE**2 * np.eye(N_ROWS), np.zeros(N_ROWS)
    return Consistency(
        mean=zero,
        covariance=CAUSES.T @ CAUSES + noise,
        ratio_range=np.array([0.01, 8.0]),
        reference=np.ones(N_ROWS),
        untouched_mean=zero,
        untouched_covariance=BENDS.T @ BENDS + noise,
        predicted_mean=zero,
        predicted_covariance=1e-2 * BENDS.T @ BENDS + noise,
        drift_limits=np.array([[0.02, 3.0], [0.002, 3.0]]),
        projection_inverse=np.eye(N_ROWS),
        thresholds=np.array([30.0, 5.0]),
    )


def followed(*, fresh=True, compensate=True):
    drift = Drift(consistency(), compensate=compensate)
    drift.restart(np.full(N_ROWS, NOISE), 100, fresh=fresh)
    return drift


def show(drift, logs, looks, predicted=NO_PREDICTION, touched=False, seed=0):
    """Show a sheet that reads ``logs`` and return the events."""
    rng, events = np.random.default_rng(seed), []
    for _ in range(looks):
        noise = NOISE * rng.standard_normal((TOGETHER, N_ROWS))
        events += drift.update(np.expm1(logs + noise).astype(np.float32), predicted, touched=touched)
    return events


def corrected(drift, logs):
    change = np.expm1(np.broadcast_to(logs, N_ROWS)).astype(np.float32)
    drift.correct(change)
    return np.log1p(change.astype(np.float64))


def expected_of_any_sheet(drift):
    """Whether only what any sheet may have drifted is reported."""
    return drift.percent == 0.0 and drift.sigma_percent == 100.0 * FILE_PRIOR


RESTED = REST_FRAMES // TOGETHER + 5


@pytest.mark.parametrize("true", [-0.1, 0.1, 0.4])
def test_a_reference_that_was_just_taken_is_followed_without_any_scan(true):
    drift = followed()
    assert (drift.percent, drift.known) == (0.0, True)
    events = show(drift, true, 40)
    assert len(events) == 1
    assert events[0].startswith("drift:")
    assert drift.percent == pytest.approx(100 * np.expm1(true), abs=0.1)
    assert drift.sigma_percent == pytest.approx(100 * CAPTURE_PRIOR)
    np.testing.assert_allclose(corrected(drift, true), 0.0, atol=0.005)


@pytest.mark.parametrize("true", [-0.1, 0.1])
def test_a_reference_from_a_file_is_corrected_once_its_sheet_is_seen_or_scanned(true):
    bent = 0.1 * BENDS[0]
    drift = followed(fresh=False)
    assert expected_of_any_sheet(drift)
    show(drift, true, 40)
    assert drift.taken_out == pytest.approx(true, abs=1e-3)
    scanned = followed(fresh=False)
    show(scanned, true + bent, RESTED, PREDICTION, touched=True)  # the gate is as wrong as the reference is
    assert scanned.taken_out == pytest.approx(true, abs=5e-3)
    assert scanned.sigma_percent == pytest.approx(0.2, abs=0.01)


def test_a_bend_that_no_scan_explains_holds_what_was_found_and_says_how_sure_that_is():
    drift = followed()
    show(drift, 0.05, 40)
    before = drift.taken_out
    show(drift, 0.3 + BENDS[0], 200)
    assert not drift.known
    assert drift.taken_out == before
    assert drift.sigma_percent == pytest.approx(
        100 * math.sqrt(CAPTURE_PRIOR**2 + 200 * TOGETHER * COMMON_WALK), rel=0.01
    )
    show(drift, 0.05, RESTED)
    assert drift.known
    assert drift.sigma_percent == pytest.approx(100 * CAPTURE_PRIOR)


def test_a_scan_that_contradicts_what_was_followed_is_not_believed():
    drift = followed()
    show(drift, 0.0, 40)
    show(drift, BENDS[0], RESTED)
    show(drift, 0.1 + 0.1 * BENDS[1], 3 * RESTED, PREDICTION)  # a tenth at once, with another shape: gauge, not drift
    assert not drift.known
    assert abs(drift.taken_out) < 1e-3


def test_a_touch_is_neither_followed_nor_scanned_away():
    touch = 0.3 * CAUSES[0] + 0.01
    for fresh in (True, False):
        drift = followed(fresh=fresh)
        show(drift, touch, 10 * RESTED, PREDICTION)  # the gate asleep
        assert not drift.known
        assert drift.taken_out == pytest.approx(0.0, abs=2e-4)
        np.testing.assert_allclose(corrected(drift, touch), touch, atol=2e-3)


@pytest.mark.parametrize(("predicted", "bend"), [(NO_PREDICTION, 1.0), (PREDICTION, 0.1)])
def test_before_anything_is_known_the_gaussian_says_what_it_can(predicted, bend):
    drift = followed(fresh=False)
    show(drift, 0.5 * MIN_COMMON + bend * np.array([1.0, -0.5, 0.3, 0.2]) @ BENDS, RESTED, predicted)
    assert drift.percent == pytest.approx(50 * MIN_COMMON, abs=1.0)
    assert drift.sigma_percent == pytest.approx(0.2 if predicted.any() else 2.0)
    assert drift.taken_out == 0.0
    assert math.isnan(drift.uneven_percent)


GRADIENT = np.linspace(-0.05, 0.05, N_ROWS)


def test_an_untouched_sheet_that_no_factor_explains_is_called_uneven_once():
    drift = followed(fresh=False)
    assert show(drift, GRADIENT, 2 * RESTED, PREDICTION) == ["drift:uneven"]
    assert drift.uneven
    assert expected_of_any_sheet(drift), "no number of its own stands for it"
    show(drift, 0.0, RESTED, PREDICTION)
    assert not drift.uneven


def test_uneven_drift_that_was_followed_is_told_and_taken_out():
    drift, field = followed(), 0.015 * np.linspace(-1.7, 1.7, N_ROWS)
    for number, part in enumerate(np.linspace(0.0, 1.0, 2000)):
        mean = np.expm1(part * field + NOISE / 11 * np.random.default_rng(number).standard_normal(N_ROWS))
        drift.update(np.broadcast_to(mean.astype(np.float32), (120, N_ROWS)), NO_PREDICTION, touched=False)
    show(drift, field, 300)
    assert drift.known
    assert drift.uneven
    assert drift.uneven_percent == pytest.approx(1.47, abs=0.1)
    assert np.sqrt(np.mean(corrected(drift, field) ** 2)) < 0.001
