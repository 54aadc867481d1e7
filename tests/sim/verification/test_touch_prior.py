"""How likely touches are before anything is measured: what a skin states, derivatives, and joints."""

import numpy as np
import pytest
from tests.sim.verification.frames import ELL, OTHER, SQUARE, changed

from eitskin_sim.verification.touch_prior import Joints, fitted_parameters, touch_prior


@pytest.mark.parametrize(("pieces", "joints"), [
    (np.vstack([SQUARE, changed(OTHER, width=20.0, border=2.0)]), ()),
    (np.vstack([SQUARE, changed(SQUARE, x=13.0, y=2.0, contrast=10.0)]), ((1, 0),)),
])  # fmt: skip
def test_derivatives_are_quotients(pieces: np.ndarray, joints: Joints) -> None:
    fitted, prior = fitted_parameters(pieces, False), touch_prior("raise")
    by = prior.jacobian(pieces, fitted, joints)
    for number, (row, parameter) in enumerate(zip(*np.nonzero(fitted), strict=True)):
        column = int(parameter) + 1
        step = np.zeros_like(pieces)
        step[row, column] = 1e-5
        high, low = (prior.residuals(pieces + sign * step, fitted, joints) for sign in (1.0, -1.0))
        scale = {3: 2.0, 4: 2.0, 6: pieces[row, 6]}.get(column, 1.0)  # half sides, log contrast
        assert scale * (high - low) / 2e-5 == pytest.approx(by[:, number], rel=1e-4, abs=1e-6)


def test_cracks_and_two_contrasts_of_one_body_cost() -> None:
    unlike = ELL.copy()
    unlike[:, 6] = 80.0, 20.0
    whole = ELL.copy()
    whole[1, [1, 3]] += -0.5, 1.0
    prior, fitted = touch_prior("raise"), fitted_parameters(ELL, False)
    costs = []
    for pieces in (unlike, ELL, whole):
        joined, apart = (float(np.square(prior.residuals(pieces, fitted, joints)).sum()) for joints in (((1, 0),), ()))
        costs.append(joined - apart)
    assert costs[0] > 100.0 > costs[1] > 2.0
    assert costs[2] == pytest.approx(0.0, abs=1e-9)
