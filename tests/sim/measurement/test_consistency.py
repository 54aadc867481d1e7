"""Rows that are not there follow from the others as a Gaussian says, and from nothing else."""

import numpy as np
import pytest

from eitskin_proto.sensor.row_gaussian import RATIO_RANGE, RowGaussian, log_of_change, rows_of
from eitskin_proto.sensor.table import N_ROWS
from eitskin_sim.measurement.consistency import VARIANCE_FLOOR, RowImputation, fit


def drawn(count: int, seed: int = 0) -> tuple[np.ndarray, RowGaussian]:
    """Return samples of a known Gaussian with six causes, and that Gaussian."""
    rng = np.random.default_rng(seed)
    causes = 0.1 * np.random.default_rng(99).standard_normal((6, N_ROWS))
    mean = np.linspace(-0.3, 0.1, N_ROWS)
    logs = mean + rng.standard_normal((count, 6)) @ causes + 0.003 * rng.standard_normal((count, N_ROWS))
    return np.expm1(logs), RowGaussian(mean, causes.T @ causes + 0.003**2 * np.eye(N_ROWS))


@pytest.mark.parametrize("electrodes", [(0,), (15,), (3, 4), (1, 7, 12)])
def test_what_is_filled_in_is_the_conditional_mean_of_the_textbook(electrodes: tuple[int, ...]) -> None:
    change, known = drawn(20)
    rows = rows_of(electrodes)
    gain = np.linalg.solve(known.covariance[np.ix_(~rows, ~rows)], known.covariance[np.ix_(~rows, rows)]).T
    expected = known.mean[rows] + (log_of_change(change[:, ~rows]) - known.mean[~rows]) @ gain.T
    filled = change.copy()
    filled[:, rows] = 55.0  # whatever stands there must not matter
    RowImputation(known).fill(filled, electrodes)
    # The covariance has a condition of 1e5: half the digits of float64 are left.
    np.testing.assert_allclose(np.log1p(filled[:, rows]), expected, atol=1e-8)
    np.testing.assert_array_equal(filled[:, ~rows], change[:, ~rows])


def test_a_fit_finds_mean_and_covariance() -> None:
    change, known = drawn(20_000)
    found = fit(change)
    # 20,000 draws: a mean is known to 0.7 % of a spread of 0.25, a variance to 1 %.
    np.testing.assert_allclose(found.mean, known.mean, atol=0.01)
    np.testing.assert_allclose(np.diag(found.covariance), np.diag(known.covariance) + VARIANCE_FLOOR, rtol=0.06)


def test_samples_beyond_any_touch_are_cut_off() -> None:
    logs = log_of_change(np.array([-5.0, -1.0, 0.0, 1e9]))
    np.testing.assert_allclose(np.exp(logs), [RATIO_RANGE[0], RATIO_RANGE[0], 1.0, RATIO_RANGE[1]])


def test_a_fit_of_one_sample_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 2 of 104 rows"):
        fit(np.zeros((1, N_ROWS)))
