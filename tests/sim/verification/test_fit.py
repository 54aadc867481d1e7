"""Touches fitted to a frame: convergence, errors, bounds, and the time that it may take."""

import numpy as np
import pytest
from tests.sim.verification.frames import SQUARE, changed, frame_of

from eitskin_sim.verification.fit import refine
from eitskin_sim.verification.shape_verdict import scatter_of, touches_of
from eitskin_sim.verification.sheet_model import SheetModel

BETWEEN = changed(SQUARE, x=1.3, y=1.7)
"""No corner on a line of the mesh, where derivatives jump."""


def test_a_converged_fit_stays_and_its_derivatives_serve_for_its_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = frame_of(SQUARE)
    assert not frame.at(SQUARE).converged
    done = refine(frame, refine(frame, frame.at(SQUARE), 20), 20)
    assert done.converged
    monkeypatch.setattr(SheetModel, "jacobian", None)  # no more of them
    assert refine(frame, done, 20) is done
    assert len(scatter_of(done)) == 5


def test_the_cost_never_rises_and_ends_near_the_truth() -> None:
    frame = frame_of(BETWEEN)
    fits = [frame.at(changed(BETWEEN, x=4.0, y=-3.0, length=2.0, width=3.0))]
    for _ in range(12):
        fits.append(refine(frame, fits[-1], 1))
    costs = [fit.cost for fit in fits]
    assert costs == sorted(costs, reverse=True)
    assert fits[-1].pieces[0, 1:5] == pytest.approx(BETWEEN[0, 1:5], abs=1.5)
    assert fits[-1].explains
    assert fits[-1].degrees_of_freedom == pytest.approx(100, abs=1)


def test_derivatives_of_a_frame_are_quotients() -> None:
    frame = frame_of(BETWEEN)
    residual, by, fitted = frame.at(BETWEEN).linear
    for number, column in enumerate((1, 2, 3, 4)):
        step = np.zeros((1, 8))
        step[0, column] = 1e-4
        fits = [frame.at(BETWEEN + sign * step) for sign in (1.0, -1.0)]
        high, low = (np.concatenate([fit.residual, fit.unlikely]) for fit in fits)
        quotient = (high - low) / (1e-4 if column > 2 else 2e-4)  # sides by half sides
        assert np.linalg.norm(by[:, number] - quotient) < 1e-3 * np.linalg.norm(quotient)
    assert len(residual) == len(by)
    assert fitted.sum() == by.shape[1]


def test_the_place_of_a_touch_that_another_one_hides_is_not_known_at_all() -> None:
    two = np.vstack([changed(SQUARE, length=30.0, width=30.0), changed(SQUARE, x=2.0, y=3.0, length=-2.0)])
    fit = frame_of(two).at(two)
    large, hidden = touches_of(fit, scatter_of(fit))
    assert max(large.centre_error_mm) < 0.5
    assert min(hidden.centre_error_mm) > 150.0
    assert np.isfinite(hidden.centre_error_mm).all()
    assert hidden.strength_error_mm2 < 1e4


def test_an_angle_that_was_fitted_has_an_error_and_size_and_contrast_are_tied() -> None:
    turned = SQUARE.copy()
    turned[0, 3:6] = 20.0, 8.0, 30.0
    frame = frame_of(turned)
    (free,), (fixed,) = (touches_of(fit, scatter_of(fit)) for fit in (frame.at(turned, True), frame.at(turned, False)))
    assert free.angle_error_deg is not None
    assert 0.0 < free.angle_error_deg < 20.0
    assert fixed.angle_error_deg is None
    assert -1.0 <= free.size_contrast_correlation < -0.5
    assert free.area_range_mm2[0] < 160.0 < free.area_range_mm2[1]
