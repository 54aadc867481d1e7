"""Where data tell only the product of size and contrast, maps and ranges say so; elsewhere nothing changes."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.shapes.parameters import areas_mm2
from eitskin_sim.verification.chi_squared import LEVEL
from eitskin_sim.verification.free import valley
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.fit import Frame, refine
from eitskin_sim.verification.free.found import FreeVerdict, drawn, map_of, scatter_of, touches_of
from eitskin_sim.verification.free.search import FreeVerifier
from eitskin_sim.verification.free.two import parted
from eitskin_sim.verification.free.usual import usual_of
from eitskin_sim.verification.free.valley import likely, scaled
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sheet.deformation import ANEW
from eitskin_sim.verification.sheet.model import Model, flat_model_V, model_of_cloud

Array = npt.NDArray[np.float64]

HARD = np.array([[0, 60.0, 45.0, 12.0, 10.0, 0.0, 50.0, 0.0]])
GENTLE = np.array([[0, 60.0, 45.0, 10.0, 10.0, 0.0, 2.0, 0.0]])


@pytest.fixture(scope="module")
def model() -> Model:
    return model_of_cloud(flat_cloud())


def verified(model: Model, pieces: Array, kind: TouchKind = "raise", shown: Array | None = None) -> FreeVerdict:
    flat_V = flat_model_V(PAPER)
    volts = flat_V * (1.0 + model.solve(pieces)[1]) * (1.0 + 3e-3 * np.random.default_rng(3).standard_normal(104))
    own = FreeVerifier(flat_V, Noise("N2", 50.0), kind)
    own.deformation.scan(lambda: model)
    own.deformation._anew = ANEW
    shares = np.array([map_of(one[None]) for one in (pieces if shown is None else shown)])
    return own.verify(volts, shares, budget_s=100.0)


def cc(one: Array, other: Array) -> float:
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


def test_a_gentle_touch_is_drawn_in_part_and_its_ranges_reach_as_far_as_the_data_allow(model: Model) -> None:
    found = verified(model, GENTLE)
    (touch,) = found.touches
    assert len(found.likely) > 1
    assert sum(share for share, _ in found.likely) == pytest.approx(1.0)
    assert np.array_equal(found.likely[0][1], found.pieces)
    truth = map_of(GENTLE)
    assert cc(found.map(), truth) > cc(map_of(found.pieces), truth) + 0.02
    assert touch.area_range_mm2[0] < 85.0 < touch.area_range_mm2[1]
    assert touch.contrast_range[0] <= 2.2


def test_a_larger_gentle_touch_is_found_along_the_valley_a_contrast_at_a_time(model: Model) -> None:
    """Each from the one before: 16 mm of contrast 3 come out as a hard touch of two thirds of the side."""
    larger = GENTLE.copy()
    larger[0, [3, 4, 6]] = 16.0, 16.0, 3.0
    found = verified(model, larger)
    contrasts = [float(pieces[0, 6]) for _, pieces in found.likely]
    assert contrasts[1:] == sorted(contrasts[1:], reverse=True)
    sides = [float(np.sqrt(areas_mm2(pieces)[0])) for _, pieces in found.likely]
    at = int(np.argmin(np.abs(np.log(contrasts) - np.log(3.0))))
    assert sides[0] < 13.0
    assert sides[at] == pytest.approx(16.0, abs=1.0)
    assert cc(found.map(), map_of(larger)) > cc(map_of(found.pieces), map_of(larger)) + 0.02


def test_what_is_far_at_one_contrast_is_not_looked_at_beyond(model: Model) -> None:
    own = FreeVerifier(flat_model_V(PAPER), Noise("N2", 50.0))
    own.deformation.scan(lambda: model)
    hard = HARD.copy()
    hard[0, 3:5] = 16.0
    frame = own._frame(model.solve(hard)[1])
    effort = Effort(100.0)
    assert len(likely(frame, frame.at(hard), effort)) == 1
    assert effort.fits == 1


def test_a_step_promises_what_it_keeps_where_derivatives_are_near(model: Model) -> None:
    own = FreeVerifier(flat_model_V(PAPER), Noise("N2", 50.0))
    own.deformation.scan(lambda: model)
    frame = own._frame(model.solve(HARD)[1])
    fit = frame.at(HARD + np.array([0, 0.2, -0.1, 0, 0, 0, 0, 0]))
    promised = valley._promised(fit, fit.linear[1])
    kept = fit.cost - refine(frame, fit, 1, by=fit.linear[1]).cost
    assert 0.0 < kept == pytest.approx(promised, rel=0.1)


def test_a_hard_touch_has_one_contrast_and_a_press_may_be_gentler(model: Model) -> None:
    found = verified(model, HARD)
    assert len(found.likely) == 1
    assert np.array_equal(found.map(), map_of(found.pieces))
    press = np.array([[2, 60.0, 45.0, 16.0, 16.0, 0.0, 0.6, 4.0]])
    softer = verified(model, press, "lower")
    assert len(softer.likely) == 2
    assert cc(softer.map(), map_of(press)) > cc(map_of(softer.pieces), map_of(press))


def test_what_goes_both_ways_and_what_is_not_there_has_no_other_contrast(model: Model) -> None:
    flat_V = flat_model_V(PAPER)
    own = FreeVerifier(flat_V, Noise("N2", 50.0))
    own.deformation.scan(lambda: model)
    frame = own._frame(np.zeros(104))
    assert len(likely(frame, frame.at(np.zeros((0, 8))), Effort(1.0))) == 1
    both = replace(frame, usual=usual_of("both"))
    assert len(likely(both, both.at(GENTLE), Effort(1.0))) == 1
    assert drawn(((1.0, np.zeros((0, 8))),), PAPER.grid).shape == PAPER.grid.shape


def test_an_angle_that_was_fitted_has_its_error_and_size_and_contrast_are_tied(model: Model) -> None:
    own = FreeVerifier(flat_model_V(PAPER), Noise("N2", 50.0))
    own.deformation.scan(lambda: model)
    turned = HARD.copy()
    turned[0, 3:6] = 20.0, 8.0, 30.0
    frame = own._frame(model.solve(turned)[1])
    fits = [frame.at(turned, turning) for turning in (True, False)]
    (free,), (fixed,) = (touches_of(fit, scatter_of(fit)) for fit in fits)
    assert free.angle_error_deg is not None
    assert 0.0 < free.angle_error_deg < 20.0
    assert fixed.angle_error_deg is None
    assert -1.0 <= free.size_contrast_correlation < -0.5
    assert free.area_range_mm2[0] < 160.0 < free.area_range_mm2[1]


def test_touches_of_another_contrast_read_alike(model: Model) -> None:
    small = GENTLE.copy()
    small[0, 3:5] = 5.0
    small[0, 6] = 50.0
    wide = scaled(small, 2.0)
    assert wide[0, 6] == pytest.approx(2.0)
    assert areas_mm2(wide) * (1.0 / 3.0) == pytest.approx(areas_mm2(small) * (49.0 / 51.0))
    one, other = model.solve(small)[1], model.solve(wide)[1]
    assert np.abs(one - other).max() < 0.2 * np.abs(one).max()


def test_two_touches_near_each_other_are_not_one_long_weak_one(model: Model) -> None:
    """A rectangle over both, at a contrast of 2, explains the frame nearly as well; two usual touches do better."""
    true = np.array([[0, 58.0, 50.0, 10.0, 10.0, 0.0, 60.0, 0.0], [0, 78.0, 50.0, 10.0, 10.0, 0.0, 60.0, 0.0]])
    usual = usual_of("raise", PAPER)
    change = model.solve(true)[1] + 3e-3 * np.random.default_rng(4).standard_normal(104)
    white = model.whitener(change, model.flat_V, Noise("N2", 50.0))
    frame = Frame(model, white, change, usual, model.expected(model.ratio(change)), 1)
    one = np.array([[0, 68.0, 50.0, 32.0, 14.0, 0.0, 2.2, 0.0]])
    start = refine(frame, frame.at(one))
    found = parted(frame, start, Effort(100.0))
    assert found.cost < start.cost
    assert len(found.pieces) == 2
    assert np.sort(found.pieces[:, 1]) == pytest.approx(true[:, 1], abs=1.5)
    short = frame.at(np.array([[0, 68.0, 50.0, 15.0, 14.0, 0.0, 2.2, 0.0]]))
    hard = frame.at(np.array([[0, 68.0, 50.0, 32.0, 14.0, 0.0, 40.0, 0.0]]))
    for fit in (short, hard, frame.at(np.zeros((0, 8)))):
        assert parted(frame, fit, Effort(100.0)) is fit


@pytest.mark.parametrize("late", [True, False])
def test_a_frame_that_time_did_not_suffice_to_explain_is_flagged(
    model: Model, late: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At p between the level of flags and what counts as explained, the search goes on; its end by time is said."""
    monkeypatch.setattr("eitskin_sim.verification.free.found.p_value", lambda *_: 3.0 * LEVEL)
    monkeypatch.setattr(Effort, "searched", lambda _: late)
    found = verified(model, HARD)
    assert found.p_value == 3.0 * LEVEL
    assert found.unfinished == late
    assert found.flagged == late
