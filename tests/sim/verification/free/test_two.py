"""One touch between two explains a frame on a sheet that is known badly, and two explain one that lies across."""

from dataclasses import replace
from itertools import count

import numpy as np
import numpy.typing as npt
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.shapes.parameters import areas_mm2
from eitskin_sim.verification.free import improve, two
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.fit import Fit
from eitskin_sim.verification.free.found import map_of
from eitskin_sim.verification.free.search import FreeVerifier
from eitskin_sim.verification.free.seen import shown_as
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sheet import model

Array = npt.NDArray[np.float64]

BETWEEN = np.array([0, 60.0, 45.0, 16.0, 11.0, 0.0, 60.0, 0.0])


def pair(contrast: float = 60.0) -> Array:
    return np.array([[0, x, 45.0, 10.0, 10.0, 0.0, contrast, 0.0] for x in (50.0, 70.0)])


def fit_of(touches: Array, found: Array) -> tuple[Fit, Effort]:
    """Return what was found of touches on a flat sheet, and time that is counted in looks at the clock."""
    looks = count()
    own = FreeVerifier(model.flat_model_V(PAPER), Noise("N2", 50.0), clock=lambda: float(next(looks)))
    own.deform(flat_cloud())
    volts = own.deformation.model.touched.solve(touches).voltages_V
    noisy = volts * (1.0 + 3e-3 * np.random.default_rng(3).standard_normal(104))
    return own._frame(noisy / model.flat_model_V(PAPER) - 1.0).at(found, False), Effort(
        600.0, lambda: float(next(looks))
    )


@pytest.mark.parametrize("contrast", [60.0, 2.5])
def test_two_touches_are_found_where_one_lies_between(contrast: float) -> None:
    """One of another contrast, too, as it comes out where it is stretched over both."""
    between = BETWEEN.copy()
    between[6] = contrast
    fit, effort = fit_of(pair(), between[None])
    found = two.apart(fit.frame, fit, np.zeros((0, 30, 45)), effort)
    order = np.argsort(found.pieces[:, 1])
    assert found.pieces[order, 1:5] == pytest.approx(pair()[:, 1:5], abs=1.0)
    assert found.cost < fit.cost - improve.SURER


def test_a_thin_touch_does_not_stay_beside_the_two_in_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of 3 mm, the narrowest there is, lies over itself by no more than that; and what lies over it goes, too."""
    thin = np.array([[0, 60.0, 45.0, 30.0, 3.0, 0.0, 60.0, 0.0], [0, 62.0, 45.0, 8.0, 8.0, 0.0, 60.0, 0.0]])
    fit, effort = fit_of(pair(), np.vstack([thin, pair()[:1] + np.array([0, 0, 35.0, 0, 0, 0, 0, 0])]))
    tried: list[Array] = []

    def fitted(_: object, pieces: Array, *__: object) -> Fit:
        tried.append(pieces)
        return fit

    monkeypatch.setattr(two, "fitted", fitted)
    monkeypatch.setattr(two, "areas_mm2", lambda pieces: pieces[:, 3])
    assert two.apart(fit.frame, fit, np.zeros((0, 30, 45)), effort) is fit
    assert tried[0][:, 2].tolist() == [80.0, 45.0, 45.0]


@pytest.mark.parametrize("narrow", [False, True])
def test_one_touch_stays_one(narrow: bool) -> None:
    """A bar is no two squares, and one that is as long as wide is not asked for."""
    one = np.array([0, 60.0, 45.0, 24.0 if narrow else 11.0, 11.0, 0.0, 60.0, 0.0])
    fit, effort = fit_of(one[None], one[None])
    assert two.apart(fit.frame, fit, np.zeros((0, 30, 45)), effort) is fit
    assert effort.fits == (2 if narrow else 0)


@pytest.mark.parametrize("explained", [False, True])
def test_what_explains_a_frame_and_the_network_shows_as_large_is_one(explained: bool) -> None:
    fit, effort = fit_of(BETWEEN[None] if explained else pair(), BETWEEN[None])
    found = two.apart(fit.frame, fit, map_of(BETWEEN[None])[None], effort)
    assert (found is fit) is explained
    assert effort.fits == (0 if explained else 2)


def test_a_touch_is_shown_as_it_was_found_where_the_nearest_one_has_its_sides() -> None:
    elsewhere, longer = BETWEEN.copy(), BETWEEN.copy()
    elsewhere[[1, 3]] = 120.0, 36.0
    longer[3] += 8.0
    shown = np.array([map_of(one[None]) for one in (BETWEEN, elsewhere)])
    assert shown_as(BETWEEN, shown, PAPER.grid)
    assert not shown_as(longer, shown, PAPER.grid)
    assert not shown_as(BETWEEN, np.zeros((0, 30, 45)), PAPER.grid)


@pytest.mark.parametrize("turned", [False, True])
def test_two_that_lie_along_one_touch_are_one(turned: bool) -> None:
    one = np.array([2, 60.0, 45.0, 34.0, 12.0, 40.0 if turned else 0.0, 60.0, 2.0])
    way = np.array([np.cos(np.deg2rad(one[5])), np.sin(np.deg2rad(one[5]))])
    halves = np.array([[2, *(one[1:3] + step * way), 14.0, 14.0, 0.0, 60.0, 2.0] for step in (-9.0, 9.0)])
    fit, effort = fit_of(one[None], halves)
    found = two.as_one(fit.frame, fit, effort)
    assert len(found.pieces) == 1
    assert found.pieces[0, 1:3] == pytest.approx(one[1:3], abs=1.0)
    assert (found.pieces[0, 5] - one[5] + 90.0) % 180.0 - 90.0 == pytest.approx(0.0, abs=10.0)
    assert found.cost < fit.cost


@pytest.mark.parametrize(("touches", "shown"), [(pair(), 2), (pair() + np.outer([0, 1], [0, 30.0, *[0] * 6]), 1)])
def test_two_stay_two_where_the_network_shows_both_and_where_they_lie_far_apart(touches: Array, shown: int) -> None:
    fit, effort = fit_of(touches, touches)
    fit = replace(fit, frame=replace(fit.frame, shown=shown))
    assert two.as_one(fit.frame, fit, effort) is fit
    assert effort.fits == 0


def test_two_that_are_two_explain_more_than_one() -> None:
    fit, effort = fit_of(pair(), pair())
    assert two.as_one(fit.frame, fit, effort) is fit
    assert effort.fits == 2


@pytest.mark.parametrize("shape", [0, 2])
def test_one_in_place_of_two_has_their_area_and_their_middle(shape: int) -> None:
    halves = pair()
    halves[:, 0] = shape
    halves[1, 3:5] = 20.0, 5.0
    one = two._along(halves)
    assert areas_mm2(one[None])[0] == pytest.approx(areas_mm2(halves).sum())
    assert one[1:3] == pytest.approx([60.0, 45.0])
    assert one[5] % 180.0 == pytest.approx(0.0, abs=1e-6)
    assert two._along(np.vstack([halves[:1], halves[:1]]))[3:5] == pytest.approx(np.sqrt(2.0) * halves[0, 3:5])


def fewer_of(found: Array, *, anyhow: bool) -> tuple[int, int]:
    """Return touches that are left of some that were found of a pair, and how often some were fitted."""
    fit, effort = fit_of(pair(), found)
    return len(improve.fewer(fit.frame, fit, effort, anyhow).pieces), effort.fits


def test_a_touch_too_many_is_left_out_though_all_is_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that answers little, or whose place another one takes where fewer may be right anyhow."""
    speck = np.array([0, 60.0, 75.0, 3.0, 3.0, 0.0, 2.0, 0.0])
    assert fewer_of(np.vstack([pair(), speck]), anyhow=False) == (2, 1)
    assert fewer_of(pair(), anyhow=False) == (2, 0)
    parts = np.array([[0, 50.0, 45.0, 10.0, 10.0, 0.0, 60.0, 0.0], [0, 67.5, 45.0, 5.0, 10.0, 0.0, 60.0, 0.0]])
    parts = np.vstack([parts, [0, 72.5, 45.0, 4.9, 10.0, 0.0, 60.0, 0.0]])
    monkeypatch.setattr(improve, "HOPELESS", 1.0)
    assert fewer_of(parts, anyhow=False) == (3, 0)
    assert fewer_of(parts, anyhow=True) == (2, 1)
