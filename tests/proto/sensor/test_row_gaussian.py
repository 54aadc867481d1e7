"""The rows that are there say of the missing ones what the textbook's conditional Gaussian says."""

import numpy as np
import pytest

from eitskin_proto.sensor.row_gaussian import (
    RATIO_RANGE,
    RowGaussian,
    change_of_log,
    log_of_change,
    missing_spread,
    missing_weights,
    precision_of,
    rows_of,
)


def gaussian(seed: int = 0) -> RowGaussian:
    causes = np.random.default_rng(seed).standard_normal((8, 104))
    return RowGaussian(np.linspace(-0.2, 0.2, 104), causes.T @ causes + 0.1 * np.eye(104))


@pytest.mark.parametrize("rows", [1, 2, 7, 104])
@pytest.mark.parametrize("condition", [1e2, 1e6])
def test_a_precision_is_the_inverse_of_its_covariance(rows: int, condition: float) -> None:
    rng = np.random.default_rng(rows)
    turned, _ = np.linalg.qr(rng.standard_normal((rows, rows)))
    covariance = turned * np.geomspace(1.0, 1.0 / condition, rows) @ turned.T
    covariance = (covariance + covariance.T) / 2.0
    found = precision_of(covariance)
    # rounding of 2^-53, times the condition, times a few for the number of rows
    np.testing.assert_allclose(found @ covariance, np.eye(rows), rtol=0, atol=20 * condition * 2.0**-53 * rows)
    np.testing.assert_array_equal(found, found.T)


@pytest.mark.parametrize("electrodes", [(0,), (3, 4), (1, 7, 12)])
def test_weights_and_spread_are_those_of_the_covariance_form(electrodes: tuple[int, ...]) -> None:
    known, rows = gaussian(), rows_of(electrodes)
    inside, across = known.covariance[np.ix_(rows, rows)], known.covariance[np.ix_(rows, ~rows)]
    others = known.covariance[np.ix_(~rows, ~rows)]
    gain = np.linalg.solve(others, across.T).T
    # The covariance has a condition of 1e4: a dozen digits are left.
    np.testing.assert_allclose(-missing_weights(known.precision(), rows), gain, atol=1e-10)
    left = np.sqrt(np.diag(inside - gain @ across.T))
    np.testing.assert_allclose(missing_spread(known.precision(), rows), left, rtol=1e-9)


def test_an_electrode_has_part_in_26_rows_and_no_electrode_in_none() -> None:
    assert [int(rows_of((electrode,)).sum()) for electrode in range(16)] == [26] * 16
    assert not rows_of(()).any()


def test_a_change_comes_back_from_its_logarithm_unless_it_was_cut_off() -> None:
    change = np.array([-0.9, 0.0, 3.0])
    np.testing.assert_allclose(change_of_log(log_of_change(change)), change, rtol=1e-14)
    beyond = change_of_log(log_of_change(np.array([-5.0, 1e9])))
    np.testing.assert_allclose(1.0 + beyond, RATIO_RANGE)
