"""The network's map: rectangles to start from, and which touches it shows."""

import numpy as np
import pytest
from tests.sim.verification.frames import ELL, SQUARE, changed, shares_of

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.area import area_map
from eitskin_sim.scene.gap import gap_mm
from eitskin_sim.scene.parts import Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_sim.verification.network_map import (
    joints_of,
    map_of,
    rectangles_of,
    starts_of,
    turned_rectangle,
    without_cracks,
)
from eitskin_sim.verification.touch_prior import touch_prior

GRID = PAPER.grid


def across(angle_deg: float) -> np.ndarray:
    return np.array([[0, 70.0, 48.0, 36.0, 12.0, angle_deg, 50.0, 0.0]])


def test_a_map_of_shapes_is_that_of_their_areas() -> None:
    assert np.allclose(map_of(SQUARE), area_map([Touch((Rect(54.0, 40.0, 66.0, 50.0),))]), atol=1e-12)
    two = np.vstack([SQUARE, changed(SQUARE, x=6.0)])
    assert np.allclose(map_of(two), area_map([Touch((Rect(54.0, 40.0, 72.0, 50.0),))]), atol=0.3)
    assert map_of(two).max() <= 1.0


def test_starts_are_the_rectangles_of_a_map_and_an_l_is_two() -> None:
    (found,) = rectangles_of(shares_of(SQUARE))
    assert found[1:5] == pytest.approx(SQUARE[0, 1:5], abs=1.0)
    ell = rectangles_of(shares_of(ELL))
    assert len(ell) == 2
    assert not ell[:, 5].any()


@pytest.mark.parametrize("angle_deg", [25.0, 60.0, 140.0])
def test_a_touch_that_lies_across_starts_turned_and_then_upright(angle_deg: float) -> None:
    found = turned_rectangle(map_of(across(angle_deg)), GRID)
    assert found[1:6] == pytest.approx(across(angle_deg)[0, 1:6], abs=1.5)
    turned, upright, none = starts_of(shares_of(across(angle_deg)), touch_prior("raise"))
    assert turned[0, 5] == pytest.approx(angle_deg, abs=2.0)
    assert len(upright)
    assert not upright[:, 5].any()
    assert not len(none)


def test_a_start_has_the_contrast_of_the_skin_and_a_press_a_graded_border() -> None:
    (hard, _), (press, _), (either, _) = (
        starts_of(shares_of(SQUARE), touch_prior(one)) for one in ("raise", "lower", "both")
    )
    assert hard[0, 6] > 10.0 > either[0, 6] / 10.0 > 1.0 > press[0, 6]
    assert (hard[0, 7], either[0, 7]) == (0.0, 0.0)
    assert press[0, 7] > 0.0
    (none,) = starts_of(shares_of(), touch_prior("lower"))
    assert none.shape == (0, 8)


def test_a_crack_within_one_touch_of_the_map_is_closed_and_gaps_between_two_stay() -> None:
    whole, two = shares_of(ELL), shares_of(*ELL)
    assert joints_of(ELL, whole, GRID) == ((1, 0),)
    found = without_cracks(ELL, whole, GRID)
    assert float(gap_mm(found[:1], found[1:])[0]) == pytest.approx(0.0, abs=1e-9)
    edges = found[:, 1] + np.outer([-0.5, 0.5], found[:, 3])
    assert (edges.min(), edges.max()) == pytest.approx((40.0, 70.0))
    far, turned = ELL.copy(), ELL.copy()
    far[1, 1] += 4.0
    turned[0, 5] = 20.0
    for pieces, shares in ((ELL, two), (far, whole), (turned, whole), (ELL[:1], whole), (ELL, whole[:0])):
        assert joints_of(pieces, shares, GRID) == ()
        assert np.array_equal(without_cracks(pieces, shares, GRID), pieces)
