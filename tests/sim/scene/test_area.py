"""The touched area of each pixel, against areas that are known and against brute sampling."""

import numpy as np
import pytest
from tests.second_skin import SECOND

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.area import area_map, shape_map
from eitskin_sim.scene.parts import Touch
from eitskin_sim.scene.shapes import Disc, Polygon, Rect

GRID = PAPER.grid

SHAPES = [
    Rect(41.3, 20.2, 55.9, 31.1),
    Disc(61.7, 48.3, 8.1),
    Disc(10.0, 10.0, 1.0),  # inside one pixel
    Disc(150 / 45 * 7, 150 / 45 * 7, 5.0),  # on a corner of the grid
    Polygon(((20.0, 20.0), (40.0, 23.0), (33.0, 41.0))),
    Polygon(((20.0, 20.0), (33.0, 41.0), (40.0, 23.0))),  # clockwise
    Polygon(((60.0, 60.0), (80.0, 60.0), (80.0, 70.0), (70.0, 70.0), (70.0, 80.0), (60.0, 80.0))),  # an L
]


@pytest.mark.parametrize("grid", [GRID, SECOND.grid])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_pixels_of_a_shape_hold_its_whole_area(shape: Rect | Disc | Polygon, grid: Grid) -> None:
    assert shape_map(shape, grid).sum() * grid.pixel_mm2 == pytest.approx(shape.area_mm2, rel=6e-3)


def test_half_a_pixel_is_half() -> None:
    found = area_map([Touch((Rect(0.0, 0.0, GRID.pitch_mm / 2, GRID.pitch_mm),))])
    assert found[0, 0] == pytest.approx(0.5, abs=1e-12)
    assert found.sum() == pytest.approx(0.5, abs=1e-12)


def test_touches_that_overlap_count_once() -> None:
    once = area_map([Touch((Rect(40.0, 40.0, 60.0, 60.0),))])
    twice = area_map([Touch((Rect(40.0, 40.0, 60.0, 60.0),)), Touch((Disc(50.0, 50.0, 6.0),))])
    assert twice == pytest.approx(once, abs=1e-12)


def test_neighbouring_units_leave_no_seam() -> None:
    touches = [Touch((Rect(*GRID.unit_rect_mm(column, 4)),)) for column in (5, 6)]
    row = area_map(touches)[15, :]
    x0, x1 = GRID.unit_rect_mm(5, 4)[0], GRID.unit_rect_mm(6, 4)[2]
    inside = (np.arange(45) * GRID.pitch_mm >= x0) & ((np.arange(45) + 1) * GRID.pitch_mm <= x1)
    assert inside.sum() >= 5
    assert row[inside] == pytest.approx(1.0, abs=1e-12)
    bits = np.zeros(126)
    bits[[4 * 14 + 5, 4 * 14 + 6]] = 1.0
    assert np.abs(area_map(touches) - GRID.map_from_units(bits)).max() <= 0.5 + 1e-9


def test_nothing_touched_is_a_map_of_zeros() -> None:
    assert not area_map([]).any()


def test_pixels_that_are_no_squares_are_halved_along_either_side() -> None:
    dx, dy = SECOND.grid.pixel_mm
    assert area_map([Touch((Rect(0.0, 0.0, dx / 2, dy),))], SECOND.grid)[0, 0] == pytest.approx(0.5, abs=1e-12)
    assert area_map([Touch((Rect(0.0, 0.0, dx, dy / 2),))], SECOND.grid)[0, 0] == pytest.approx(0.5, abs=1e-12)
