"""Gauss-Newton on problems whose answer is known."""

import numpy as np
import pytest
from scipy.stats import kstest

from eitskin_sim.calibration.fit import fit


class Linear:
    """Rows that depend linearly on the parameters, with noise of 1."""

    bound = np.inf

    def __init__(self, jacobian, read):
        self.jacobian, self.read, self.softness = jacobian, read, 1.0

    @property
    def count(self):
        return self.jacobian.shape[1]

    def inside(self, z):
        return np.clip(z, -self.bound, self.bound)

    def soften(self, z, error):
        self.softness = 1.0 / np.hypot(1.0, 10.0 * error)

    def residuals(self, z):
        return self.softness * (self.read - self.jacobian @ z)

    def linearised(self, z):
        return self.residuals(z), self.softness * self.jacobian


class Bent(Linear):
    """The same seen through a curve."""

    def residuals(self, z):
        return self.softness * (self.read - np.sinh(self.jacobian @ z))

    def linearised(self, z):
        return self.residuals(z), self.softness * np.cosh(self.jacobian @ z)[:, None] * self.jacobian


def drawn(seed):
    rng = np.random.default_rng(seed)
    jacobian = rng.standard_normal((40, 6)) * np.array([30.0, 10.0, 3.0, 1.0, 0.1, 0.0])
    truth = rng.standard_normal(6)
    return jacobian, truth, jacobian @ truth + rng.standard_normal(40)


def test_estimates_are_as_far_off_as_they_say_and_the_misfit_is_chi_square():
    scores, misfits = [], []
    for seed in range(200):
        jacobian, truth, read = drawn(seed)
        found = fit(Linear(jacobian, read))
        scores.append((found.z - truth) / found.sd)
        misfits.append(40.0 * found.misfit)
    assert np.allclose(np.std(scores, axis=0), 1.0, atol=0.2)  # 200 draws: 5 %
    assert kstest(misfits, "chi2", args=(40,)).pvalue > 1e-3
    assert np.max(np.abs(scores)) < 5.0


def test_the_standard_error_is_that_of_fisher_s_information_and_what_no_row_tells_keeps_its_prior():
    jacobian, _, read = drawn(1)
    found = fit(Linear(jacobian, read))
    assert np.allclose(found.sd**2, np.diag(np.linalg.inv(jacobian.T @ jacobian + np.eye(6))))
    assert found.sd[5] == pytest.approx(1.0)
    assert found.z[5] == pytest.approx(0.0)
    learned = np.einsum("ri,ij,rj->r", jacobian, np.linalg.inv(jacobian.T @ jacobian + np.eye(6)), jacobian)
    assert np.allclose(found.expected**2, 1.0 - learned)


def test_a_curve_is_followed():
    rng = np.random.default_rng(3)
    jacobian, truth = 0.5 * rng.standard_normal((60, 4)), rng.standard_normal(4)
    found = fit(Bent(jacobian, np.sinh(jacobian @ truth) + 0.01 * rng.standard_normal(60)))
    assert np.abs(found.z - truth).max() < 3.0 * found.sd.max()


def test_a_search_that_never_gets_better_ends_where_it_began_and_says_so():
    class Wrong(Bent):
        def linearised(self, z):
            residuals, jacobian = super().linearised(z)
            return residuals, -jacobian

    jacobian, _, read = drawn(5)
    model = Wrong(0.01 * jacobian, read)
    found = fit(model)
    assert not found.settled
    assert found.misfit <= model.residuals(np.zeros(6)) @ model.residuals(np.zeros(6)) / 40.0


def test_a_parameter_at_its_bound_stays_there_and_the_others_are_the_best_beside_it():
    jacobian, _, read = drawn(2)
    model = Linear(jacobian, read)
    free = fit(model).z
    model.bound = 0.5 * np.abs(free).max()
    found = fit(model)
    at = np.abs(found.z) > model.bound - 1e-9
    assert at[np.abs(free).argmax()]
    assert np.abs(found.z).max() <= model.bound
    slope = jacobian.T @ model.residuals(found.z) - found.z
    assert np.allclose(slope[~at], 0.0, atol=1e-3), "nothing is left to gain inside"
    assert np.all(slope[at] * np.sign(found.z[at]) > 0.0), "and what is at the bound is pushed out"


def test_a_sheet_that_cannot_be_ends_the_search_at_the_last_one_that_can():
    class Edge(Linear):
        def linearised(self, z):
            if np.any(z):
                raise ValueError("electrode 4 lies round a corner")
            return super().linearised(z)

    jacobian, _, read = drawn(6)
    found = fit(Edge(jacobian, read))
    assert not found.settled
    assert not found.z.any()
