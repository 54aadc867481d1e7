"""The verifier off the unit grid: it finds what was drawn, says how sure it is, and more time does no harm."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.mesh import Metric
from eitskin_sim.scene.area import area_map
from eitskin_sim.scene.parts import Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_sim.shapes.parameters import areas_mm2
from eitskin_sim.verification.free.fit import TRIES, Fit, Frame, bounded, refine
from eitskin_sim.verification.free.found import FreeVerdict, map_of, scatter_of, touches_of
from eitskin_sim.verification.free.search import FreeVerifier
from eitskin_sim.verification.free.starts import followed, presses_of, shares_of, starts_of
from eitskin_sim.verification.free.usual import usual_of
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sheet.model import Model, flat_model_V
from eitskin_sim.verification.sheet.waves import waves_of

Array = npt.NDArray[np.float64]

LONG_S = 100.0
SQUARE = np.array([[0, 60.0, 45.0, 12.0, 10.0, 0.0, 50.0, 0.0]])
BETWEEN = SQUARE + np.array([0, 1.0, 1.0, 0, 0, 0, 0, 0])  # no corner at a mesh's line, where derivatives jump


def moved(by: list[float]) -> Array:
    return np.asarray(SQUARE + np.array(by), dtype=np.float64)


def flat_metric(xy_mm: Array) -> Array:
    return np.tile([1.0, 0.0, 1.0], (len(xy_mm), 1))


@lru_cache(maxsize=1)
def verifier() -> FreeVerifier:
    found = FreeVerifier(flat_V(), Noise("N2", 50.0))
    found.deform(flat_cloud())
    return found


@lru_cache(maxsize=1)
def flat_V() -> Array:
    return flat_model_V(PAPER)


def share(pieces: Array) -> Array:
    return np.array([map_of(one[None]) for one in pieces]).reshape(len(pieces), *PAPER.grid.shape)


@lru_cache(maxsize=1)
def true_model() -> Model:
    """Of the flat sheet as it is: a verifier makes its own anew where a frame shows that the sheet is stretched."""
    untouched = FreeVerifier(flat_V(), Noise("N2", 50.0))
    untouched.deform(flat_cloud())
    return untouched.deformation.model


@pytest.fixture(autouse=True, scope="module")
def models() -> None:
    """Make the models that all tests here share."""
    true_model()
    verifier()


def seen(pieces: Array, seed: int = 0) -> Array:
    model = true_model()
    volts = (1.0 + model.solve(pieces)[1]) * flat_V()
    return np.asarray(volts * (1.0 + 10**-2.5 * np.random.default_rng(seed).standard_normal(104)))


def verified(pieces: Array, start: Array, budget_s: float = LONG_S) -> FreeVerdict:
    own = verifier()
    own.deform(flat_cloud())  # what it learned of the material with other frames is forgotten
    return own.verify(seen(pieces), share(start), budget_s=budget_s)


def test_a_map_of_shapes_is_that_of_their_areas() -> None:
    touch = Touch((Rect(54.0, 40.0, 66.0, 50.0),))
    assert np.allclose(map_of(SQUARE), area_map([touch]), atol=1e-12)
    two = np.vstack([SQUARE, moved([0, 6.0, 0, 0, 0, 0, 0, 0])])
    assert np.allclose(map_of(two), area_map([Touch((Rect(54.0, 40.0, 72.0, 50.0),))]), atol=0.3)
    assert map_of(two).max() <= 1.0


def test_starts_are_the_rectangles_of_a_map_and_an_l_is_two() -> None:
    found = starts_of(share(SQUARE))
    assert found.shape == (1, 8)
    assert np.allclose(found[0, 1:5], SQUARE[0, 1:5], atol=1.0)
    ell = np.array([[0, 45, 50, 10, 40, 0, 50, 0], [0, 60, 35, 20, 10, 0, 50, 0]], dtype=float)
    assert len(starts_of(map_of(ell)[None])) == 2
    assert len(starts_of(np.zeros((0, *PAPER.grid.shape)))) == 0


def test_touches_are_followed_to_where_the_map_shows_as_many_and_else_stay_where_they_were() -> None:
    last = np.vstack([SQUARE, moved([0, 40.0, 20.0, 3.0, 0, 0, 5.0, 1.0])])
    now = np.vstack([moved([0, 43.0, 22.0, 9.0, 9.0, 0, 0, 0]), moved([0, -2.0, 1.0, 9.0, 9.0, 0, 0, 0])])
    found = followed(last, now)
    assert np.array_equal(found[:, 1:3], now[[1, 0], 1:3])
    assert np.array_equal(found[:, 3:], last[:, 3:])
    far = now.copy()
    far[0, 1] += 30.0
    for other in (now[:1], far, np.vstack([now[1], now[1]]), np.zeros((0, 8))):
        assert np.array_equal(followed(last, other), last)
    none = np.zeros((0, 8))
    assert followed(none, none).shape == (0, 8)


def test_where_the_map_is_off_it_still_is_so_a_followed_touch_moves_as_the_map_does() -> None:
    last = moved([0, 0.4, -0.3, 0, 0, 0, 0, 0])
    before, now = moved([0, 0, 0, 1, 1, 0, 0, 0]), moved([0, 3.0, 2.0, 1, 1, 0, 0, 0])
    assert followed(last, now, before)[0, 1:3] == pytest.approx(last[0, 1:3] + [3.0, 2.0])
    assert followed(last, now, now[:0])[0, 1:3] == pytest.approx(now[0, 1:3])


def test_a_followed_touch_stays_on_the_sheet_although_the_map_moves_beyond_where_it_was_off() -> None:
    own = verifier()
    own.deform(flat_cloud())
    at_border, shown, then = (moved([0, x - 60.0, 0, -4.0, -2.0, 0, 0, 0]) for x in (6.0, 14.0, 2.0))
    last = own.verify(seen(at_border), share(shown), budget_s=LONG_S).pieces
    found = own.verify(seen(then), share(then), last, budget_s=LONG_S)
    assert len(found.pieces) == 1
    assert found.pieces[0, 1:3] == pytest.approx(then[0, 1:3], abs=2.0)
    with pytest.raises(ValueError, match="beyond the sheet"):
        true_model().solve(moved([0, -80.0, 0, 0, 0, 0, 0, 0]))


def test_settled_touches_stay_and_their_derivatives_serve_their_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = verifier()._frame(seen(SQUARE) / flat_V() - 1.0)
    assert not frame.at(SQUARE).settled
    done = refine(frame, refine(frame, frame.at(SQUARE), 20), 20)
    assert done.settled
    monkeypatch.setattr(Model, "jacobian", None)  # no more of them
    assert refine(frame, done, 20) is done
    assert len(scatter_of(done)) == 5


def test_a_step_that_leads_up_is_shortened_only_if_much_is_to_be_gained(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = verifier()._frame(seen(BETWEEN) / flat_V() - 1.0)
    done = refine(frame, frame.at(BETWEEN), 20)
    sd_mm = np.sqrt(np.square(scatter_of(done)[:, 0, 0]).sum())
    for off, tries in ((0.3, 1), (6.0, TRIES)):
        begun, tried = frame.at(done.pieces + np.array([0, off * sd_mm, 0, 0, 0, 0, 0, 0])), []

        def worse(_: Frame, pieces: Array, turning: bool, begun: Fit = begun, tried: list[Array] = tried) -> Fit:
            tried.append(pieces)
            return replace(begun, price=begun.price + 1e3, turning=turning)

        with monkeypatch.context() as held:
            held.setattr(Frame, "at", worse)
            found = refine(frame, begun, 1)
        assert len(tried) == tries
        assert np.array_equal(found.pieces, begun.pieces)
        assert found.settled is (tries == 1)


def test_errors_of_a_fit_are_told_by_the_derivatives_of_its_last_short_step() -> None:
    frame = verifier()._frame(seen(BETWEEN) / flat_V() - 1.0)
    near = refine(frame, refine(frame, frame.at(BETWEEN), 20), 20)
    best = refine(frame, frame.at(near.pieces + np.array([0, 0.1, 0.1, 0, 0, 0, 0, 0])))
    assert not best._linear, "its last step gained next to nothing"
    told, own = scatter_of(best), scatter_of(frame.at(best.pieces))
    assert np.sqrt(np.square(told).sum(axis=0)) == pytest.approx(np.sqrt(np.square(own).sum(axis=0)), rel=0.2)


def test_where_a_touch_lies_that_another_one_hides_is_not_known_at_all() -> None:
    two = np.vstack([moved([0, 0, 0, 30.0, 30.0, 0, 0, 0]), moved([0, 2.0, 3.0, -2.0, 0, 0, 0, 0])])
    fit = verifier()._frame(seen(two) / flat_V() - 1.0).at(two)
    large, hidden = touches_of(fit, scatter_of(fit))
    assert max(large.centre_error_mm) < 0.5
    assert min(hidden.centre_error_mm) > 150.0
    assert np.isfinite(hidden.centre_error_mm).all()
    assert hidden.strength_error_mm2 < 1e4


def uneven_metric(xy_mm: Array) -> Array:
    x, y = xy_mm.T / 100.0
    return np.stack([1.2 + 0.1 * x + 0.05 * x * y, 0.1 * x - 0.2 * y, 0.9 + 0.1 * y + 0.05 * x], axis=-1)


@pytest.mark.parametrize("metric", [flat_metric, uneven_metric])
def test_waves_keep_the_border_and_their_rates_are_quotients(metric: Metric) -> None:
    waves = waves_of()
    ends = ([[0.0, 30.0], [150.0, 70.0]], [[20.0, 0.0], [90.0, 100.0]])
    for axis, edge in enumerate(ends):
        assert np.abs(waves.along(axis, np.array(edge))[0]).max() < 1e-12
    at = np.array([[33.0, 21.0], [101.0, 77.0]])
    rates = np.array(waves.rates(metric, at))
    for number in (1, 5, 17, 18, 20, 29):
        step = np.zeros(len(waves.sd))
        step[number] = 1e-4
        quotient = (waves.moved(metric, step)(at) - waves.moved(metric, -step)(at)) / 2e-4
        assert np.allclose(rates[:, :, number].T, quotient, atol=2e-5)


def test_a_material_that_lies_elsewhere_has_the_metric_of_the_points_that_it_lies_under() -> None:
    """The moved metric measures a short way as the metric does between where its ends lie."""
    waves, rng = waves_of(), np.random.default_rng(3)
    amplitudes = 0.02 * rng.standard_normal(len(waves.sd))

    def lies(at: Array) -> Array:
        parts = np.split(amplitudes, [6 * 3])
        return at + np.stack([waves.along(axis, at)[0] @ part for axis, part in enumerate(parts)], axis=-1)

    at, way = np.array([[40.0, 30.0], [110.0, 64.0]]), 1e-4 * rng.standard_normal((2, 2))
    length = [
        np.einsum("kc,kc->k", metric(where), np.stack([w[:, 0] ** 2, 2.0 * w[:, 0] * w[:, 1], w[:, 1] ** 2], axis=-1))
        for metric, where, w in (
            (waves.moved(uneven_metric, amplitudes), at, way),
            (uneven_metric, lies(at), lies(at + way) - lies(at)),
        )
    ]
    assert length[0] == pytest.approx(length[1], rel=1e-4)


@pytest.mark.slow
def test_a_touch_is_found_within_its_errors_from_a_wrong_start() -> None:
    verdict = verified(SQUARE, moved([0, 4.0, -3.0, 2.0, 3.0, 0, 0, 0]))
    (touch,) = verdict.touches
    assert not verdict.flagged
    assert np.hypot(touch.centre_mm[0] - 60.0, touch.centre_mm[1] - 45.0) < 4.0 * np.hypot(*touch.centre_error_mm)
    assert max(touch.centre_error_mm) < 1.0
    assert abs(touch.strength_mm2 - 120.0 * np.log(50.0)) < 4.0 * touch.strength_error_mm2
    assert touch.size_contrast_correlation < -0.5
    assert touch.area_range_mm2[0] < touch.area_mm2 < touch.area_range_mm2[1]


@pytest.mark.slow
def test_a_press_below_contrast_1_is_found_and_has_a_negative_strength() -> None:
    press = SQUARE.copy()
    press[0, 3:7] = 16.0, 16.0, 0.0, 0.4
    own = FreeVerifier(flat_V(), Noise("N2", 50.0), "lower")
    own.deform(flat_cloud())
    found = own.verify(seen(press), share(press), budget_s=LONG_S)
    assert found.touches
    assert all(touch.strength_mm2 < 0.0 for touch in found.touches)
    assert not found.flagged


@pytest.mark.slow
def test_what_no_touch_explains_is_flagged() -> None:
    odd = seen(SQUARE) * (1.0 + 0.03 * (-1.0) ** np.arange(104))
    assert verifier().verify(odd, share(SQUARE), budget_s=0.5).flagged


def test_without_a_deformation_or_time_it_says_so() -> None:
    own = FreeVerifier(np.ones(104), Noise("N2", 50.0))
    with pytest.raises(ValueError, match="give its cloud first"):
        own.verify(np.ones(104), share(SQUARE))


def test_a_skin_whose_touches_go_one_way_gets_none_of_the_other() -> None:
    own = verifier()
    change = seen(SQUARE) / flat_V() - 1.0
    frame = own._frame(change)
    assert frame.usual.sign == 1
    fit = frame.at(SQUARE)
    free = np.zeros((1, 7), dtype=np.bool_)
    free[0, 5] = True
    held = bounded(frame, fit.pieces, free, np.array([-9.0]))
    for _ in range(9):
        held = bounded(frame, held, free, np.array([-9.0]))
    assert held[0, 6] > 1.0
    assert usual_of("lower").sign == -1
    assert usual_of("both").sign == 0


def test_a_map_without_touches_starts_from_none_and_a_press_is_round_with_a_border() -> None:
    none = np.zeros(0, dtype=np.intp)
    assert shares_of(none, none, np.zeros(0), 0, PAPER.grid).shape == (0, *PAPER.grid.shape)
    press = presses_of(SQUARE, 3.0)
    assert areas_mm2(press) == pytest.approx(areas_mm2(SQUARE))
    assert press[0, 7] == 3.0
    assert presses_of(np.zeros((0, 8)), 3.0).shape == (0, 8)
