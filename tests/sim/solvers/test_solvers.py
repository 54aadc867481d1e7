"""Classical solvers against closed forms: normal equations, optimality conditions, a likelihood that must rise."""

import numpy as np
import pytest

from eitskin_sim.solvers import bounded
from eitskin_sim.solvers.bounded import bounded_minimum
from eitskin_sim.solvers.l1 import l1_image
from eitskin_sim.solvers.operators import SATURATED_CONTRAST, build_operators
from eitskin_sim.solvers.sbl import bounded_map, learn, sbl_image
from eitskin_sim.solvers.tikhonov import tikhonov_matrix


def problem(rows=20, cells=30, seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((rows, cells)), rng.standard_normal(rows)


@pytest.fixture(scope="module")
def units():
    return build_operators(cells="units")


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0])
def test_tikhonov_solves_the_stacked_least_squares(power):
    operator, data = problem()
    weight = np.linalg.norm(operator, axis=0) ** power
    strength = 1e-3 * np.linalg.norm(operator / weight, 2) ** 2
    stacked = np.concatenate([operator, np.sqrt(strength) * np.diag(weight)])
    expected = np.linalg.lstsq(stacked, np.concatenate([data, np.zeros(30)]), rcond=None)[0]
    # Two solvers of a system with a condition of 1e3: twelve digits.
    assert np.allclose(tikhonov_matrix(operator, 1e-3, power) @ data, expected, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan")])
def test_tikhonov_without_regularisation_is_refused(factor):
    with pytest.raises(ValueError, match="above 0"):
        tikhonov_matrix(np.eye(3), factor)


@pytest.mark.parametrize(("factor", "upper"), [(0.5, np.inf), (0.01, 0.3)])
def test_l1_meets_its_optimality_conditions(factor, upper):
    operator, data = problem()
    image = l1_image(operator, data, factor=factor, upper=upper, iterations=20_000)
    slope = operator.T @ (operator @ image - data) + factor * np.abs(operator.T @ data).max()
    free = (image > 0.0) & (image < upper)
    assert np.abs(slope[free]).max(initial=0.0) < 1e-6
    assert slope[image == 0.0].min(initial=0.0) > -1e-6
    assert slope[image == upper].max(initial=0.0) < 1e-6
    assert image.min() >= 0.0
    assert image.max() <= upper


def test_l1_of_an_orthonormal_operator_is_soft_thresholding():
    data = np.array([3.0, -2.0, 0.5, 0.05])
    assert np.allclose(l1_image(np.eye(4), data, factor=0.1), np.maximum(data - 0.3, 0.0), atol=1e-12)


@pytest.mark.parametrize("seed", range(2))
def test_likelihood_rises_with_every_step_without_coupling(seed):
    operator, data = problem(20, 30, seed)
    found = learn(operator, data, (5, 6), coupling=0.0, iterations=30, tolerance=0.0)
    steps = np.diff(found.log_likelihood)
    assert len(steps) == 30
    assert steps.min() > -1e-8 * np.abs(found.log_likelihood).max()


def test_posterior_mean_is_the_regularised_least_squares_under_the_learned_prior():
    operator, data = problem()
    found = learn(operator, data, (5, 6))
    precision = operator.T @ operator / found.noise_variance + np.linalg.inv(found.covariance)
    expected = np.linalg.solve(precision, operator.T @ data / found.noise_variance)
    assert np.allclose(found.mean, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("lower", "upper"), [(0.0, np.inf), (0.0, 0.2), (-0.25, 0.25), (-0.25, np.inf)])
def test_bounded_map_meets_its_optimality_conditions(lower, upper):
    operator, data = problem(30, 20)
    rng = np.random.default_rng(7)
    root = rng.standard_normal((20, 20))
    covariance = root @ root.T / 20 + 0.1 * np.eye(20)
    image = bounded_map(operator, data, covariance, 0.5, upper, lower)
    slope = operator.T @ (operator @ image - data) / 0.5 + np.linalg.solve(covariance, image)
    free = (image > lower) & (image < upper)
    assert free.any()
    assert image.min() == lower
    assert np.abs(slope[free]).max() < 1e-6  # the covariance's floor of 1e-9 is in it
    assert slope[image == lower].min(initial=0.0) > -1e-6
    assert slope[image == upper].max(initial=0.0) < 1e-6


@pytest.mark.parametrize("rounds", [1, 25])
@pytest.mark.parametrize("upper", [np.inf, 1.0, 0.05])
@pytest.mark.parametrize("seed", range(2))
def test_bounded_minimum_is_found_by_either_way_of_changing_cells(monkeypatch, seed, upper, rounds):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((40, 40)) * np.exp(rng.uniform(-3, 3, 40))  # scales of cells differ 400-fold
    hessian, linear = root.T @ root + 1e-3 * np.eye(40), root.T @ rng.standard_normal(40)
    monkeypatch.setattr(bounded, "BLOCK_ROUNDS", rounds)
    image = bounded_minimum(hessian, linear, upper)
    size = np.sqrt(np.diag(hessian))
    slope = (hessian @ image - linear) / size  # in units where every cell is worth the same
    free = (image > 0.0) & (image < upper)
    assert np.abs(slope[free]).max(initial=0.0) < 1e-8 * np.abs(linear / size).max()
    assert slope[image == 0.0].min(initial=0.0) > -1e-8
    assert slope[image == upper].max(initial=0.0) < 1e-8


def test_bounded_minimum_of_separate_cells_is_clipping():
    assert np.allclose(bounded_minimum(np.diag([1.0, 4.0, 2.0]), np.array([-1.0, 2.0, 9.0]), 3.0), [0.0, 0.5, 3.0])


def test_no_data_gives_an_empty_image_and_a_wrong_grid_is_refused():
    operator, data = problem()
    assert not sbl_image(operator, np.zeros(20), (5, 6)).any()
    with pytest.raises(ValueError, match="30 cells, the grid 4 x 6"):
        sbl_image(operator, data, (4, 6))


@pytest.mark.parametrize("unit", [0, 60])
def test_every_solver_finds_a_faint_touch_where_it_is(units, unit):
    # A change too small to saturate is what the operators linearise: data made of one column has one answer.
    data = 0.5 * units.relative_jacobian[:, unit]
    for image in (
        l1_image(units.relative_jacobian, data, upper=SATURATED_CONTRAST),
        sbl_image(units.relative_jacobian, data, units.shape, upper=SATURATED_CONTRAST),
    ):
        assert int(np.argmax(image)) == unit
    tikhonov = tikhonov_matrix(units.relative_jacobian, 1e-8) @ data
    assert int(np.argmax(tikhonov)) == unit


def test_pixels_add_up_to_the_whole_sheet_as_units_do(units):
    # Raising the conductivity everywhere is one change, however the sheet is cut up.
    pixels = build_operators(cells="pixels")
    whole = pixels.relative_jacobian.sum(axis=1)
    assert np.allclose(whole, units.relative_jacobian.sum(axis=1), rtol=5e-3)
    # V goes as 1 / sigma but for the contact impedance, which takes a few thousandths.
    assert np.allclose(whole, -1.0, atol=5e-3)


def test_unknown_cells_are_refused():
    with pytest.raises(ValueError, match="'voxels'"):
        build_operators(cells="voxels")
