"""Touches anywhere: exact on their own mesh, close to a mesh that follows every border, labelled by area."""

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.forward import Factor
from eitskin_sim.freeform import parts
from eitskin_sim.freeform.draws import set_pool
from eitskin_sim.freeform.sheet import InvertedSheet, inverted_sheet, sheet_blocks
from eitskin_sim.freeform.voltages import set_voltages
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.touch_table import TouchTable, gather

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
    monkeypatch.setattr(parts, "PARTS_PER_BATCH", 4)
    flat = inverted_sheet(Bend())
    some = gather([touches.of(number) for number in range(10)])
    both = set_voltages([sheet, flat], some)
    assert both[0] == pytest.approx(set_voltages([sheet], some)[0], rel=1e-12)
    assert both[1] == pytest.approx(set_voltages([flat], some)[0], rel=1e-12)
    assert np.abs(both[0] / both[1] - 1.0).max() > 0.01


def test_no_touch_leaves_the_sheet_untouched(sheet: InvertedSheet) -> None:
    assert np.abs(change(sheet)).max() == 0.0
    assert sheet.untouched_V == pytest.approx(sheet.system.factorise().voltages(), rel=1e-9)


def test_a_sparse_table_holds_the_touched_area_of_each_set(touches: TouchTable) -> None:
    table = touches.area_table().toarray()
    for number in range(60):
        area = sum(shape.area_mm2 for touch in touches.touches(number) for shape in touch.shapes)
        assert table[number].sum() * PAPER.grid.pitch_mm**2 == pytest.approx(area, rel=2e-3, abs=0.05)
    some = touches.chosen(np.array([5, 3]))
    assert np.array_equal(some.of(1), touches.of(3))
