"""A skin's description: the paper's is what was meant before there was one, and every other says what it says."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.parts import Layer, Map, Outline, Ring, Touches
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER, Skin

ARCS = tuple(float(arc) for arc in 10.0 + 38.75 * np.arange(16))
LARGE = Skin(
    outline=Outline(size_mm=(220.0, 90.0)), electrodes=Ring(arc_length_mm=Quantity(ARCS)), map=Map((27, 66), (9, 22))
)


def test_the_paper_s_skin_has_the_id_and_the_grid_that_every_artefact_carries():
    assert PAPER.grid_id == "ef41b0aa6e17eb61"
    assert PAPER.touch_kind == "raise"
    grid = PAPER.grid
    assert (grid.size_mm, grid.shape, grid.units, grid.quarter) == ((150.0, 100.0), (30, 45), (9, 14), (15, 23))
    assert grid.pitch_mm == 150.0 / 45
    rows, columns = np.indices((30, 45))
    np.testing.assert_array_equal(grid.pixel_centres_mm()[..., 0], (columns + 0.5) * (150.0 / 45))
    np.testing.assert_array_equal(grid.pixel_centres_mm()[..., 1], (rows + 0.5) * (150.0 / 45))
    assert sorted(set(np.bincount(grid.unit_of_pixel.ravel()).tolist())) == [9, 12, 16]


def test_pixels_and_units_tile_any_sheet():
    grid = LARGE.grid
    centres = grid.pixel_centres_mm()
    np.testing.assert_allclose(centres.reshape(-1, 2).mean(axis=0), (110.0, 45.0))
    assert grid.pixel_mm2 * grid.n_pixels == pytest.approx(220.0 * 90.0)
    areas = np.zeros(grid.n_units)
    for unit in range(grid.n_units):
        row, column = divmod(unit, grid.units[1])
        x0, y0, x1, y1 = grid.unit_rect_mm(column, row)
        areas[unit] = (x1 - x0) * (y1 - y0)
        inside = (centres[..., 0] > x0) & (centres[..., 0] < x1) & (centres[..., 1] > y0) & (centres[..., 1] < y1)
        np.testing.assert_array_equal(inside, grid.unit_of_pixel == unit)
    assert areas.sum() == pytest.approx(220.0 * 90.0)
    with pytest.raises(ValueError, match=r"unit \[22, 0\] is not on the sheet: columns are 0 to 21, rows 0 to 8"):
        grid.unit_rect_mm(22, 0)


def test_a_map_of_units_is_read_back_from_it():
    grid = Grid((60.0, 60.0), (12, 12), (4, 3))
    values = np.arange(12.0)
    assert [set(grid.map_from_units(values)[grid.unit_of_pixel == unit]) for unit in range(12)] == [
        {value} for value in values
    ]


def test_the_digest_stands_for_all_but_the_name():
    assert replace(PAPER, name="other").digest == PAPER.digest
    others = [
        replace(PAPER, layer=Layer(gauge_factor=Quantity(0.0, "normal", 0.5))),
        replace(PAPER, touches=Touches(kind="both")),
        replace(PAPER, calibrated_from=PAPER.digest),
        replace(PAPER, calibrated_from=PAPER.digest, stated_grid_id="0123456789abcdef"),
        LARGE,
    ]
    assert len({PAPER.digest, *(skin.digest for skin in others)}) == 6
    assert [skin.grid_id == PAPER.grid_id for skin in others] == [True, True, True, False, False]
    assert len({PAPER, replace(PAPER), replace(PAPER, outline=Outline())}) == 1  # as the key of a cache


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"outline": Outline("disc", (100.0, 90.0))}, "expected twice the same number, the disc's diameter"),
        ({"electrodes": Ring(size_mm=Quantity(32.0))}, r"\[electrodes\] 0 and 1 overlap by 0.75 mm"),
        ({"electrodes": Ring(arc_length_mm=Quantity((43.75, 12.5, *PAPER.arc_length_mm[2:])))}, "counter-clockwise"),
        ({"outline": Outline(size_mm=(100.0, 100.0))}, r"arc_length_mm\[15\] is 481.25, expected below 400"),
    ],
)
def test_parts_that_contradict_each_other_are_refused(changed, words):
    with pytest.raises(ValueError, match=words):
        replace(PAPER, **changed)
