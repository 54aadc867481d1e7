"""Touches both ways in the free generator: exact on their own mesh, near a scene's, never silently nothing."""

from functools import cache

import numpy as np
import pytest

from eitskin_sim.fem.forward import Factor
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.freeform.draws import set_pool
from eitskin_sim.freeform.sheet import InvertedSheet, inverted_sheet, sheet_blocks
from eitskin_sim.freeform.touches import CLASSES, Ranges, pool_of
from eitskin_sim.freeform.voltages import set_voltages
from eitskin_sim.scene.gap import half_extents_mm
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.touch_table import DISC, ELLIPSE, RECTANGLE, TouchTable, gather

BEND = Bend(angle_deg=70.0, axis_deg=-30.0, twist_deg=10.0, stretch_along=1.08, stretch_across=0.97, nonuniformity=0.05)

Piece = list[float]


@pytest.fixture(scope="module")
def sheet() -> InvertedSheet:
    return inverted_sheet(BEND)


def disc(x: float, y: float, size: float, contrast: float, border: float = 0.0) -> Piece:
    return [DISC, x, y, size, size, 0.0, contrast, border]


def ellipse(x: float, y: float, contrast: float, border: float = 0.0) -> Piece:
    return [ELLIPSE, x, y, 20.0, 12.0, 30.0, contrast, border]


def square(x: float, y: float, size: float, contrast: float, border: float = 0.0, angle: float = 0.0) -> Piece:
    return [RECTANGLE, x, y, size, size, angle, contrast, border]


def table(*sets: list[Piece]) -> TouchTable:
    return gather([np.array(pieces) for pieces in sets])


SETS: dict[str, list[Piece]] = {
    "lowering": [square(40.3, 40.1, 20.0, 0.5)],
    "lowering, graded": [disc(40.3, 40.1, 16.0, 0.4, 4.0)],
    "raising, graded": [ellipse(60.3, 40.1, 30.0, 3.0)],
    "two that lower": [disc(40.3, 40.1, 16.0, 0.4, 4.0), ellipse(90.0, 60.0, 0.2)],
    "both ways": [disc(40.3, 40.1, 16.0, 0.4), disc(90.0, 60.0, 10.0, 5.0, 2.0), square(120.0, 30.0, 12.0, 0.7)],
    "both ways, hard first": [square(90.0, 60.0, 10.0, 50.0), disc(40.3, 40.1, 16.0, 0.4)],
    "both ways in one element": [disc(40.3, 40.1, 16.0, 0.4, 4.0), disc(58.0, 40.1, 16.0, 5.0, 4.0)],
    "mixed parts and others": [
        disc(40.3, 40.1, 16.0, 0.4, 4.0),
        disc(58.0, 40.1, 16.0, 5.0, 4.0),
        square(100.0, 60.0, 16.0, 0.2),
        disc(117.5, 60.0, 16.0, 60.0),
        ellipse(90.0, 20.0, 0.6, 8.0),
    ],
    "a graded and a sharp one in one element": [disc(40.3, 40.1, 16.0, 0.4, 8.0), square(57.5, 40.1, 15.0, 20.0)],
    "under a contact": [[RECTANGLE, 12.0, 5.0, 20.0, 9.0, 0.0, 0.2, 4.0]],
    "nearly an insulator": [disc(40.3, 40.1, 16.0, 1e-3)],
    "six that lower": [disc(20.0 + 22.0 * k, 30.0 + 40.0 * (k % 2), 14.0, 0.25 + 0.1 * k, k) for k in range(6)],
}


# Before there were signed factors every set that lowers conductance gave the untouched voltages.
def test_sets_of_any_signs_are_exact_on_their_mesh(sheet: InvertedSheet) -> None:
    own = table(*SETS.values())
    for name, number, row in zip(SETS, range(len(own)), set_voltages([sheet], own)[0], strict=True):
        naive = Factor(sheet.system, *sheet_blocks(sheet, own, number)).voltages()
        assert row == pytest.approx(naive, rel=1e-9), name
        assert np.abs(row / sheet.untouched_V - 1.0).max() > 0.02, name


def test_chains_that_share_touches_of_both_signs_are_exact_too(sheet: InvertedSheet) -> None:
    pool = set_pool({0: (60, 0)}, 4, touches="both")
    touches = pool.touches(pool.sets[0])
    fast = set_voltages([sheet], touches)[0]
    signs = [set(np.sign(np.log(touches.of(number)[:, 6])).tolist()) for number in range(60)]
    several = [number for number in range(60) if len(signs[number]) == 2][:6]
    assert len(several) == 6
    for number in several:
        naive = Factor(sheet.system, *sheet_blocks(sheet, touches, number)).voltages()
        assert fast[number] == pytest.approx(naive, rel=1e-9)


SHAPES: dict[str, Piece] = {
    "disc": disc(71.3, 52.1, 16.0, 1.0),
    "ellipse": ellipse(71.3, 52.1, 1.0),
    "turned square": square(71.3, 52.1, 16.0, 1.0, 0.0, 25.0),
}


# Elements of 3.5 mm against meshes of the touches' own; 1.5 % is the median, below 5 % nearly all.
@pytest.mark.heavy
@pytest.mark.parametrize("contrast", [pytest.param(0.4, marks=pytest.mark.slow), 20.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_every_sign_border_and_shape_is_near_a_scene_on_a_mesh_of_its_own(
    sheet: InvertedSheet, shape: str, contrast: float
) -> None:
    for border in (0.0, 2.0, 8.0):
        own = table([[*SHAPES[shape][:6], contrast, border]])
        exact = scene_voltages(own.touches(0)) / scene_voltages(()) - 1.0
        found = set_voltages([sheet], own)[0, 0] / sheet.untouched_V - 1.0
        assert np.linalg.norm(found - exact) < 0.05 * np.linalg.norm(exact)
        assert np.linalg.norm(exact) > 0.1


@cache
def scene_voltages(touches: tuple[Touch, ...]) -> np.ndarray:
    return solve_scene(Scene(bend=BEND, touches=touches, element_size_mm=3.0)).voltages


def test_a_border_that_narrows_becomes_the_sharp_one(sheet: InvertedSheet) -> None:
    for contrast in (0.3, 20.0):
        sharp, narrow, wide = set_voltages(
            [sheet], table(*([disc(71.3, 52.1, 16.0, contrast, border)] for border in (0.0, 0.5, 6.0)))
        )[0]
        change = np.linalg.norm(sharp / sheet.untouched_V - 1.0)
        assert np.linalg.norm((narrow - sharp) / sheet.untouched_V) < 0.05 * change
        assert np.linalg.norm((wide - sharp) / sheet.untouched_V) > 0.05 * change


@pytest.mark.parametrize(
    ("piece", "message"),
    [
        (disc(40.0, 40.0, 16.0, 1.0), "contrast must be above 0 and differ from 1"),
        (disc(40.0, 40.0, 16.0, 0.0), "contrast must be above 0"),
        (disc(40.0, 40.0, 16.0, -2.0), "contrast must be above 0"),
        (disc(40.0, 40.0, 16.0, np.nan), "contrast must be above 0"),
        (disc(240.0, 40.0, 16.0, 0.5), "outside the sheet of 150 x 100 mm, where it changes nothing"),
        (disc(40.0, 40.0, 0.0, 0.5), "sides must be above 0 mm"),
        (disc(40.0, 40.0, 16.0, 0.5, 0.2), "a graded border must be from 0.5 mm to the touch's width"),
        (disc(40.0, 40.0, 16.0, 0.5, 17.0), "a graded border must be from 0.5 mm to the touch's width"),
    ],
)
def test_a_touch_that_would_change_nothing_is_an_error(sheet: InvertedSheet, piece: Piece, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        set_voltages([sheet], table([disc(100.0, 40.0, 16.0, 0.5)], [piece]))


@pytest.mark.parametrize(("kind", "lowering"), [("press", 1.0), ("raise", 0.0), ("both", 0.5)])
def test_presses_are_on_the_sheet_and_of_the_sizes_borders_and_contrasts_they_say(kind: str, lowering: float) -> None:
    pieces = pool_of(kind, 640, np.random.default_rng(1)).pieces
    lowers, usual = pieces[:, 6] < 1.0, Ranges("both")
    assert np.all((pieces[lowers, 6] >= usual.lowering[0]) & (pieces[lowers, 6] <= usual.lowering[1]))
    assert np.all((pieces[~lowers, 6] >= usual.raising[0]) & (pieces[~lowers, 6] <= usual.raising[1]))
    assert lowers.mean() == pytest.approx(lowering, abs=0.1 if kind == "both" else 0.0)
    half = half_extents_mm(pieces)
    assert np.all((pieces[:, 1:3] >= half - 1e-9) & (pieces[:, 1:3] <= np.array([150.0, 100.0]) - half + 1e-9))
    pressed = pieces[lowers] if lowering else pieces[pieces[:, 7] > 0.0]
    assert np.all((pressed[:, 3:5] >= usual.sizes_mm[0]) & (pressed[:, 3:5] <= usual.sizes_mm[1]))
    graded = pressed[pressed[:, 7] > 0.0]
    assert 0.6 < len(graded) / len(pressed) < 0.9 if lowering else 0.3 < len(graded) / len(pieces) < 0.45
    assert np.all(
        (graded[:, 7] >= usual.borders_mm[0]) & (graded[:, 7] <= np.minimum(usual.borders_mm[1], graded[:, 4]))
    )
    assert set(pressed[:, 0]) == {DISC, ELLIPSE, RECTANGLE}
    assert len(np.unique(pieces[:, 6])) == CLASSES


def test_presses_are_as_strong_as_measured_ones(sheet: InvertedSheet) -> None:
    pool = pool_of("press", 160, np.random.default_rng(2))
    pieces = pool.pieces
    area = np.where(pieces[:, 0] == RECTANGLE, 1.0, np.pi / 4) * pieces[:, 3] * pieces[:, 4]
    low, middle, high = np.quantile(area * (1.0 - pieces[:, 6]), (0.1, 0.5, 0.9))
    assert low < 99.0 < middle < 180.0 < high < 300.0  # mm^2; measured 99 to 269 at 10 to 20 mm depth
    change = np.abs(set_voltages([sheet], pool)[0] / sheet.untouched_V - 1.0)
    typical = np.quantile(np.median(change, axis=1), (0.25, 0.5, 0.75))
    assert np.all((typical > (0.005, 0.009, 0.012)) & (typical < (0.014, 0.02, 0.03)))  # measured 0.7 to 1.8 %
