"""What touches are like before anything is measured, and when physics and network contradict each other."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from eitskin_proto.skin.parts import Touches
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.gap import gap_mm
from eitskin_sim.verification.free import improve
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.fit import Frame
from eitskin_sim.verification.free.found import map_of
from eitskin_sim.verification.free.improve import AGAINST_JOINT
from eitskin_sim.verification.free.prior.costs import cost_rates, costs, heavy, own_parameters
from eitskin_sim.verification.free.prior.joints import Joints, bodies
from eitskin_sim.verification.free.seen import (
    BESIDE,
    DECISIVE,
    closed,
    joints_of,
    together,
    unseen,
)
from eitskin_sim.verification.free.usual import Usual, usual_of

SQUARE = np.array([[0, 60.0, 45.0, 12.0, 10.0, 0.0, 50.0, 0.0]])
OTHER = np.array([[0, 110.0, 70.0, 10.0, 10.0, 0.0, 50.0, 0.0]])


def shares_of(pieces: np.ndarray) -> np.ndarray:
    return np.array([map_of(one[None]) for one in pieces]).reshape(len(pieces), *PAPER.grid.shape)


def test_a_touch_that_only_physics_sees_is_known_by_its_place() -> None:
    both = np.vstack([SQUARE, OTHER])
    near = both + np.array([0, 4.0, -3.0, 0, 0, 0, 0, 0])
    assert unseen(near, shares_of(both), PAPER.grid) == []
    assert unseen(near, shares_of(SQUARE), PAPER.grid) == [1]
    assert unseen(both, shares_of(np.zeros((0, 8))), PAPER.grid) == [0, 1]


def test_a_crack_within_one_touch_of_the_map_is_closed_and_gaps_between_two_stay() -> None:
    ell = np.array([[0, 45.0, 50.0, 10.0, 40.0, 0.0, 50.0, 0.0], [0, 60.5, 35.0, 19.0, 10.0, 0.0, 50.0, 0.0]])
    whole = map_of(ell)[None]
    found = closed(ell, whole, PAPER.grid)
    assert float(gap_mm(found[:1], found[1:])[0]) == pytest.approx(0.0, abs=1e-9)
    edges = found[:, 1] + np.outer([-0.5, 0.5], found[:, 3])
    assert edges.min() == pytest.approx(40.0)
    assert edges.max() == pytest.approx(70.0)
    assert np.array_equal(closed(ell, shares_of(ell), PAPER.grid), ell)
    wide = ell + np.array([[0.0] * 8, [0, 4.0, 0, 0, 0, 0, 0, 0]])
    assert np.array_equal(closed(wide, whole, PAPER.grid), wide)
    assert np.array_equal(closed(ell, whole[:0], PAPER.grid), ell)


def test_shapes_that_are_one_touch_of_the_map_hang_together_and_cracks_and_two_contrasts_cost() -> None:
    ell = np.array([[0, 45.0, 50.0, 10.0, 40.0, 0.0, 80.0, 0.0], [0, 60.5, 35.0, 19.0, 10.0, 0.0, 20.0, 0.0]])
    whole, grid = map_of(ell)[None], PAPER.grid
    assert joints_of(ell, whole, grid) == ((1, 0),)
    assert joints_of(ell, shares_of(ell), grid) == (), "the network shows two"
    turned, far = ell.copy(), ell + np.array([[0.0] * 8, [0, 4.0, 0, 0, 0, 0, 0, 0]])
    turned[0, 5] = 20.0
    assert joints_of(turned, whole, grid) == joints_of(far, whole, grid) == joints_of(ell[:1], whole, grid) == ()
    assert (bodies(2, ()), bodies(2, ((1, 0),)), bodies(4, ((1, 0), (2, 1), (2, 0)))) == (2, 1, 2)
    body = together(ell, ((1, 0),), whole, grid)
    assert body[:, 6] == pytest.approx([40.0, 40.0])
    usual, own = usual_of("raise"), own_parameters(ell, False)
    more = [
        float(np.sum(np.square(costs(one, own, usual, ((1, 0),))))) - float(np.sum(np.square(costs(one, own, usual))))
        for one in (ell, body)
    ]
    assert more[0] > 100.0
    assert more[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("more", "bound"), [(AGAINST_JOINT - 1.0, True), (AGAINST_JOINT + 1.0, False)])
def test_what_the_network_shows_as_one_is_made_one_unless_the_frame_speaks_against_it(
    monkeypatch: pytest.MonkeyPatch, more: float, bound: bool
) -> None:
    ell = np.array([[0, 45.0, 50.0, 10.0, 40.0, 0.0, 50.0, 0.0], [0, 60.5, 35.0, 19.0, 10.0, 0.0, 50.0, 0.0]])
    frame = Frame(SimpleNamespace(skin=PAPER), *[cast(Any, None)] * 4)  # type: ignore[arg-type]
    fit: Any = SimpleNamespace(pieces=ell, chi_squared=100.0, turning=False)

    def fitted(frame: Frame, pieces: np.ndarray, turning: bool, effort: Effort, over: object) -> Any:
        assert frame.joints == ((1, 0),)
        return SimpleNamespace(pieces=pieces, chi_squared=100.0 + more)

    monkeypatch.setattr(improve, "fitted", fitted)
    found = improve.joined(frame, fit, map_of(ell)[None], Effort(100.0))
    assert (found is not fit) == bound
    assert improve.joined(frame, fit, shares_of(ell), Effort(100.0)) is fit


def test_a_touch_that_only_physics_sees_must_answer_much(monkeypatch: pytest.MonkeyPatch) -> None:
    fit: Any = SimpleNamespace(pieces=np.vstack([SQUARE, OTHER]), chi_squared=100.0)
    frame: Any = SimpleNamespace(model=SimpleNamespace(skin=PAPER))
    none = np.zeros((0, *PAPER.grid.shape))
    for shares, more, left in (
        (shares_of(SQUARE), BESIDE - 1.0, 1),
        (shares_of(SQUARE), BESIDE + 1.0, 2),
        (none, DECISIVE - 1.0, 0),
        (none, DECISIVE + 1.0, 2),
    ):

        def without(frame: Any, fit: Any, number: int, effort: Effort, more: float = more) -> Any:
            return SimpleNamespace(pieces=np.delete(fit.pieces, number, axis=0), chi_squared=fit.chi_squared + more)

        monkeypatch.setattr(improve, "without", without)
        found, sure = improve.confirmed(frame, fit, shares, Effort(100.0))
        assert (len(found.pieces), sure) == (left, True)


def test_contrast_and_size_are_what_the_skin_states() -> None:
    weak = replace(PAPER, touches=Touches(raising_contrast=(1.6, 2.5), size_mm=(8.0, 12.0)))
    usual, plain = usual_of("raise", weak), usual_of("raise")
    assert np.exp(usual.log_contrast) == pytest.approx(2.0)
    assert usual.common_sd < 0.4 < plain.common_sd
    assert usual.touches.size_mm == pytest.approx(np.sqrt(96.0))
    assert usual.touches.size_log_sd < plain.touches.size_log_sd
    assert usual_of("lower").log_contrast < 0.0 < plain.log_contrast
    assert (usual_of("lower").sign, plain.sign, usual_of("both").sign) == (-1, 1, 0)


def test_a_prior_of_aspects_has_heavy_tails_and_its_slope_is_a_quotient() -> None:
    for value in (-2.0, -0.3, 1e-9, 0.2, 1.4):
        here, slope = heavy(value, 0.35)
        assert slope == pytest.approx((heavy(value + 1e-6, 0.35)[0] - heavy(value - 1e-6, 0.35)[0]) / 2e-6, rel=1e-4)
        assert np.sign(here) == np.sign(value)
    assert heavy(1e-3, 0.35)[0] == pytest.approx(1e-3 / 0.35, rel=1e-4)
    assert heavy(2.0, 0.35)[0] < 0.6 * 2.0 / 0.35


def test_the_prior_s_derivatives_are_quotients() -> None:
    pieces = np.vstack([SQUARE, OTHER])
    pieces[1, 4], pieces[1, 7] = 30.0, 2.0
    own, usual = own_parameters(pieces, False), usual_of("raise")
    agree(pieces, own, usual, ())
    apart = np.vstack([SQUARE, SQUARE + np.array([0, 13.0, 2.0, 0, 0, 0, 10.0, 0])])
    agree(apart, own_parameters(apart, False), usual, ((1, 0),))


def agree(pieces: np.ndarray, own: np.ndarray, usual: Usual, joints: Joints) -> None:
    """Check derivatives of the prior against quotients."""
    by = cost_rates(pieces, own, usual, joints)
    columns = {3: (3, 0.5), 4: (4, 0.5)}  # half length, half width: of the table's column, and its factor
    for number, (row, parameter) in enumerate(zip(*np.nonzero(own), strict=True)):
        column, factor = columns.get(int(parameter) + 1, (int(parameter) + 1, 1.0))
        step = np.zeros_like(pieces)
        step[row, column] = 1e-5
        found = [costs(pieces + sign * step, own, usual, joints) for sign in (1.0, -1.0)]
        scale = pieces[row, 6] if column == 6 else 1.0 / factor
        assert scale * (found[0] - found[1]) / 2e-5 == pytest.approx(by[:, number], rel=1e-4, abs=1e-6)
