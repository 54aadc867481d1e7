"""Rows taken out of precomputed operators: as if they had never been there, to rounding."""

import numpy as np
import pytest

from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_sim.solvers.downdate import Precomputed, precompute
from eitskin_sim.solvers.l1 import l1_image
from eitskin_sim.solvers.operators import Operators, build_operators
from eitskin_sim.solvers.tikhonov import FACTOR, SENSITIVITY_POWER, tikhonov_matrix


@pytest.fixture(scope="module")
def operators() -> Operators:
    return build_operators(cells="units")


@pytest.fixture(scope="module")
def kept(operators: Operators) -> Precomputed:
    return precompute(operators)


def rebuilt(operators: Operators, gone: np.ndarray) -> np.ndarray:
    """Build Tikhonov's matrix from the rows that are left: in the cells' space, by another formula."""
    whole = operators.relative_jacobian
    weight = np.linalg.norm(whole, axis=0) ** SENSITIVITY_POWER
    damping = FACTOR * np.linalg.norm(whole / weight, 2) ** 2
    left = whole[~gone] / weight
    normal = left.T @ left + damping * np.eye(whole.shape[1])
    return np.asarray(np.linalg.solve(normal, left.T) / weight[:, None])


@pytest.mark.parametrize("electrodes", [(0,), (5,), (2, 3), (1, 8, 14)])
def test_a_downdated_matrix_equals_one_built_anew(
    operators: Operators, kept: Precomputed, electrodes: tuple[int, ...]
) -> None:
    gone = rows_of(electrodes)
    anew, found = rebuilt(operators, gone), kept.tikhonov(gone)
    # Both are solved with a condition of 1e4: ten digits of float64 remain and a little is lost twice.
    np.testing.assert_allclose(found, anew, rtol=0, atol=1e-9 * np.abs(anew).max())
    assert np.abs(tikhonov_matrix(operators.relative_jacobian)[:, ~gone] - anew).max() > 1e-3 * np.abs(anew).max()


def test_with_nothing_lost_the_matrix_is_the_solver_s(operators: Operators, kept: Precomputed) -> None:
    whole = tikhonov_matrix(operators.relative_jacobian)
    found = kept.tikhonov(np.zeros(104, dtype=np.bool_))
    np.testing.assert_allclose(found, whole, rtol=0, atol=1e-10 * np.abs(whole).max())


def test_downdating_equals_filling_the_lost_data_in(operators: Operators, kept: Precomputed) -> None:
    gone, data = rows_of((7,)), np.random.default_rng(0).standard_normal(104)
    filled = data.copy()
    filled[gone] = -np.linalg.solve(kept.inverse[np.ix_(gone, gone)], kept.inverse[np.ix_(gone, ~gone)] @ data[~gone])
    np.testing.assert_allclose(kept.tikhonov(gone) @ data[~gone], kept.matrix @ filled, rtol=1e-8, atol=1e-9)


def test_rows_go_one_electrode_after_the_other_as_both_at_once(operators: Operators, kept: Precomputed) -> None:
    first, both = rows_of((4,)), rows_of((4, 11))
    stepwise = kept.inverse
    for gone in (first, both & ~first):
        part, left = np.flatnonzero(gone), ~gone
        stepwise = stepwise - stepwise[:, part] @ np.linalg.solve(stepwise[np.ix_(part, part)], stepwise[part])
        stepwise[gone] = 0.0
        stepwise[:, gone] = 0.0
        assert left.any()
    once = kept.inverse[np.ix_(~both, ~both)] - kept.inverse[np.ix_(~both, both)] @ np.linalg.solve(
        kept.inverse[np.ix_(both, both)], kept.inverse[np.ix_(both, ~both)]
    )
    np.testing.assert_allclose(stepwise[np.ix_(~both, ~both)], once, atol=1e-9 * np.abs(once).max())


def test_l1_of_the_rows_that_are_left_is_that_of_a_smaller_scan(operators: Operators, kept: Precomputed) -> None:
    gone, data = rows_of((10,)), 0.05 * np.random.default_rng(1).standard_normal(104)
    operator, lipschitz = kept.left(gone)
    assert lipschitz == pytest.approx(np.linalg.norm(operator, 2) ** 2, rel=1e-10)
    found = l1_image(operator, data[~gone], upper=2.0, lipschitz=lipschitz)
    np.testing.assert_allclose(found, l1_image(operators.relative_jacobian[~gone], data[~gone], upper=2.0), atol=1e-9)
