"""Touches anywhere: exact on their own mesh, close to a mesh that follows every border, labelled by area."""

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.forward import Factor
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.freeform import parts
from eitskin_sim.freeform.draws import set_pool
from eitskin_sim.freeform.sheet import InvertedSheet, inverted_sheet, sheet_blocks
from eitskin_sim.freeform.voltages import set_responses, set_voltages
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_sim.scene.touch_table import TouchTable, cover, gather

BEND = Bend(angle_deg=70.0, axis_deg=-30.0, twist_deg=10.0, stretch_along=1.08, stretch_across=0.97, nonuniformity=0.05)


@pytest.fixture(scope="module")
def sheet() -> InvertedSheet:
    return inverted_sheet(BEND)


@pytest.fixture(scope="module")
def touches() -> TouchTable:
    pool = set_pool({0: (150, 0)}, 0)
    return pool.touches(pool.sets[0])


def rectangle(x: float, y: float, length: float, width: float, angle: float = 0.0, sigma: float = 50.0) -> list[float]:
    return [0.0, x, y, length, width, angle, sigma]


def change(sheet: InvertedSheet, *pieces: list[float]) -> np.ndarray:
    voltages = set_voltages([sheet], gather([np.array(pieces).reshape(-1, 7)]))[0, 0]
    return np.asarray(voltages / sheet.untouched_V - 1.0)


# The promise is 1e-8; both ways round at 1e-9 or less on the weakest rows.
def test_voltages_are_those_of_one_factorisation_a_sample(sheet: InvertedSheet, touches: TouchTable) -> None:
    pick = [number for number in range(150) if len(touches.of(number)) in (1, 2, 4, 8)][:10]
    some = gather([touches.of(number) for number in pick])
    fast = set_voltages([sheet], some)[0]
    for row, number in zip(fast, range(len(pick)), strict=True):
        naive = Factor(sheet.system, *sheet_blocks(sheet, some, number)).voltages()
        assert row == pytest.approx(naive, rel=1e-8)
        assert np.abs(row / sheet.untouched_V - 1.0).max() > 1e-4


def test_a_touch_under_a_contact_and_one_over_the_whole_sheet_are_exact_too() -> None:
    some = gather([np.array([rectangle(12.0, 5.0, 20.0, 9.0)]), np.array([rectangle(75.0, 50.0, 150.0, 100.0)])])
    sheet = inverted_sheet(BEND, 8.0)
    for number, row in enumerate(set_voltages([sheet], some, 8.0)[0]):
        naive = Factor(sheet.system, *sheet_blocks(sheet, some, number)).voltages()
        assert row == pytest.approx(naive, rel=1e-8)


def test_deformations_share_batches_without_mixing(
    sheet: InvertedSheet, touches: TouchTable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parts, "BATCH", 4)
    flat = inverted_sheet(Bend())
    some = gather([touches.of(number) for number in range(10)])
    both = set_voltages([sheet, flat], some)
    assert both[0] == pytest.approx(set_voltages([sheet], some)[0], rel=1e-12)
    assert both[1] == pytest.approx(set_voltages([flat], some)[0], rel=1e-12)
    assert np.abs(both[0] / both[1] - 1.0).max() > 0.01


def test_no_touch_leaves_the_sheet_untouched(sheet: InvertedSheet) -> None:
    assert np.abs(change(sheet)).max() == 0.0
    assert sheet.untouched_V == pytest.approx(sheet.system.factorise().voltages(), rel=1e-9)


@pytest.mark.parametrize(("x", "y"), [(71.3, 52.1), (33.9, 27.4), (104.6, 71.7)])
def test_a_touch_keeps_its_size_within_a_quarter_of_a_millimetre(sheet: InvertedSheet, x: float, y: float) -> None:
    touch = Touch((Rect(x - 5.0, y - 5.0, x + 5.0, y + 5.0),))
    touched, untouched = (
        solve_scene(Scene(bend=BEND, touches=touches, element_size_mm=2.0)).voltages for touches in ((touch,), ())
    )
    exact = touched / untouched - 1.0
    here = change(sheet, rectangle(x, y, 10.0, 10.0))
    per_mm = (change(sheet, rectangle(x, y, 10.5, 10.5)) - here) / 0.5
    size_error_mm = float((here - exact) @ per_mm / (per_mm @ per_mm))
    assert abs(size_error_mm) < 0.25
    assert np.linalg.norm(here - exact) < 0.05 * np.linalg.norm(exact)
    assert np.linalg.norm(change(sheet, rectangle(x, y, 11.0, 11.0)) - exact) > 0.1 * np.linalg.norm(exact)


# The seam lies inside elements, where halves are integrated apart: their points differ by a thousandth of the touch.
def test_a_seam_between_two_pieces_does_not_show(sheet: InvertedSheet) -> None:
    whole = change(sheet, rectangle(60.7, 41.3, 18.0, 12.0))
    halves = change(sheet, rectangle(56.2, 41.3, 9.0, 12.0), rectangle(65.2, 41.3, 9.0, 12.0))
    assert np.linalg.norm(halves - whole) < 0.01 * np.linalg.norm(whole)
    gap = change(sheet, rectangle(54.7, 41.3, 6.0, 12.0), rectangle(66.7, 41.3, 6.0, 12.0))
    assert np.linalg.norm(gap - whole) > 0.05 * np.linalg.norm(whole)


def test_labels_add_up_to_the_touched_area(touches: TouchTable) -> None:
    for number in range(60):
        area = sum(shape.area_mm2 for touch in touches.touches(number) for shape in touch.shapes)
        assert touches.areas(number).sum() * PAPER.grid.pitch_mm**2 == pytest.approx(area, rel=2e-3, abs=0.05)


def test_the_label_of_a_straight_rectangle_is_exact() -> None:
    lines = np.arange(0.0, 31.0, 10.0)
    rows, columns, share = cover(np.array(rectangle(12.5, 10.0, 15.0, 10.0)), lines, lines)
    found = np.zeros((3, 3))
    found[rows, columns] = share
    assert np.allclose(found, [[0.25, 0.5, 0.0], [0.25, 0.5, 0.0], [0.0, 0.0, 0.0]], atol=1e-14)


def test_turning_a_rectangle_by_90_degrees_swaps_its_sides() -> None:
    lines = np.linspace(0.0, 40.0, 13)
    for angle, sides in ((90.0, (9.0, 17.0)), (0.0, (17.0, 9.0))):
        found, expected = np.zeros((2, 12, 12))
        rows, columns, share = cover(np.array(rectangle(20.3, 19.1, 17.0, 9.0, angle)), lines, lines)
        found[rows, columns] = share
        rows, columns, share = cover(np.array(rectangle(20.3, 19.1, *sides)), lines, lines)
        expected[rows, columns] = share
        assert np.abs(found - expected).max() < 0.02  # strips of 0.1 mm against exact


def test_a_sparse_table_of_areas_is_what_sets_have_one_by_one(touches: TouchTable) -> None:
    table = np.minimum(touches.area_table().toarray(), 1.0)
    for number in range(0, 150, 7):
        assert table[number] == pytest.approx(touches.areas(number).ravel(), abs=1e-12)
    some = touches.chosen(np.array([5, 3]))
    assert np.array_equal(some.of(1), touches.of(3))


# Energy can only fall when a part of the sheet conducts better: so must every resistance between electrodes.
def test_resistances_fall_when_a_touch_conducts_better(sheet: InvertedSheet, touches: TouchTable) -> None:
    some = touches.chosen(np.arange(40))
    lines = np.eye(16) - np.roll(np.eye(16), 5, axis=0)
    before = np.full((len(some), 16), np.inf)
    for factor in (1.0 / 20.0, 0.5, 1.0, 3.0):
        pieces = some.pieces * [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, factor]
        response = set_responses([sheet], TouchTable(pieces, some.first))[0]
        resistance = np.einsum("ed,nef,fd->nd", lines, response, lines)
        assert resistance.min() > 0.0
        assert (resistance - before).max() < 1e-12 * resistance.max()
        before = resistance
    assert (before < 0.999 * np.einsum("ed,ef,fd->d", lines, sheet.at_terminals, lines)).any()


def test_every_voltage_keeps_its_sign(sheet: InvertedSheet, touches: TouchTable) -> None:
    ratio = set_voltages([sheet], touches)[0] / sheet.untouched_V
    assert ratio.min() > 0.0
    assert ratio.max() < 6.0
