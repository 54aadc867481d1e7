"""Missing rows: filled in as a Gaussian says, and taken out of a projection as if it had been built without them."""

import numpy as np
import pytest

from eitskin.health.imputation import Imputation, without_rows
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ROWS

RANGE = np.array([0.01, 8.0])


def gaussian() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    causes = 0.1 * rng.standard_normal((8, N_ROWS))
    return 0.1 * rng.standard_normal(N_ROWS), causes.T @ causes + 1e-4 * np.eye(N_ROWS)


@pytest.mark.parametrize("electrodes", [(0,), (2, 3), (4, 9, 15)])
def test_filled_in_rows_are_the_conditional_mean(electrodes: tuple[int, ...]) -> None:
    mean, covariance = gaussian()
    rows, precision = rows_of(electrodes), np.linalg.inv(covariance)
    filling = Imputation(mean, precision, RANGE)
    filling.leave_out(rows, precision)
    logs = np.random.default_rng(1).multivariate_normal(mean, covariance)
    change = np.expm1(logs).astype(np.float32)
    change[rows] = np.nan  # whatever a dead electrode reads
    kept = change.copy()
    filling.fill(change)
    gain = np.linalg.solve(covariance[np.ix_(~rows, ~rows)], covariance[np.ix_(~rows, rows)]).T
    expected = np.expm1(mean[rows] + gain @ (logs[~rows] - mean[~rows]))
    np.testing.assert_allclose(change[rows], expected, atol=1e-4)  # dV passes through float32, and P has 1e4
    np.testing.assert_array_equal(change[~rows], kept[~rows])


def test_what_is_filled_in_stays_within_what_a_sheet_can_show() -> None:
    mean, covariance = gaussian()
    precision = np.linalg.inv(covariance)
    filling = Imputation(mean, precision, RANGE)
    filling.leave_out(rows_of((1,)), precision)
    for value in (1e30, -1e30, 7.0, -1.0):
        change = np.full(N_ROWS, value, dtype=np.float32)
        filling.fill(change)
        assert np.all((change[filling.missing] >= RANGE[0] - 1.0 - 1e-6) & (change[filling.missing] <= RANGE[1] - 1.0))


@pytest.mark.parametrize("electrodes", [(0,), (7,), (3, 11), (1, 2, 3)])
def test_a_projection_without_rows_equals_one_that_is_built_without_them(electrodes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    jacobian = rng.standard_normal((N_ROWS, 30)) @ rng.standard_normal((30, 200)) / 30
    tau = 1e-3 * np.linalg.norm(jacobian, 2) ** 2
    inverse = np.linalg.inv(jacobian @ jacobian.T + tau * np.eye(N_ROWS))
    whole = jacobian.T @ inverse
    rows = rows_of(electrodes)
    left = jacobian[~rows]
    anew = left.T @ np.linalg.inv(left @ left.T + tau * np.eye(len(left)))
    found = without_rows(whole.astype(np.float32), inverse, rows)
    np.testing.assert_allclose(found[:, ~rows], anew, atol=1e-6 * np.abs(anew).max())  # float32 in, float32 out
    assert not found[:, rows].any()
