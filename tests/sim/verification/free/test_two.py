"""One touch between two explains a frame on a sheet that is known badly, and two explain one that lies across."""

from itertools import count

import numpy as np
import numpy.typing as npt
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
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
