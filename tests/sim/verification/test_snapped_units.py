"""Units snapped from shapes: right ones stay, doubtful ones are decided by the frame, wrong ones are flagged."""

import numpy as np
import numpy.typing as npt
import pytest

from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.touch_table import RECTANGLE
from eitskin_sim.verification.fit import Budget
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.shape_verdict import ShapeVerdict
from eitskin_sim.verification.sheet_model import SheetModel, model_of_cloud
from eitskin_sim.verification.snapped_units import UnitFrame, UnitVerdict, too_many, unit_shares
from eitskin_sim.verification.touch_prior import touch_prior

Array = npt.NDArray[np.float64]
GRID = PAPER.grid
TOUCHED = (17, 60, 61)
"""Units: one alone, and two beside each other."""


def pieces(units: tuple[int, ...], contrast: float = 50.0, moved_mm: float = 0.0) -> Array:
    found = np.zeros((len(units), 8))
    for row, unit in zip(found, units, strict=True):
        x0, y0, x1, y1 = GRID.unit_rect_mm(unit % GRID.units[1], unit // GRID.units[1])
        row[:] = RECTANGLE, (x0 + x1) / 2 + moved_mm, (y0 + y1) / 2, x1 - x0, y1 - y0, 0.0, contrast, 0.0
    return found


@pytest.fixture(scope="module")
def model() -> SheetModel:
    return model_of_cloud(GRID.flat_cloud_mm())


def snapped(
    model: SheetModel, shapes: Array, shown: tuple[int, ...], gone: tuple[int, ...] = (), contrast: float = 50.0
) -> UnitVerdict:
    """Return the verdict on a frame of the touched units, of which physics found some shapes."""
    change = model.solve(pieces(TOUCHED, contrast))[1]
    read = 1.0 + change
    read *= 1.0 + 3e-3 * np.random.default_rng(4).standard_normal(104)
    read[rows_of(gone)] = 7.0
    prior = touch_prior("raise", PAPER)
    frame = UnitFrame(model, model.flat_V * read, model.flat_V, Noise("N2"), prior, ~rows_of(gone))
    bits = np.isin(np.arange(GRID.n_units), shown)
    found = ShapeVerdict((), 100.0, 100, 0.5, 0.01, 1, 0.1, pieces=shapes, likely=((1.0, shapes),))
    return frame.snapped(found, bits, Budget(60.0))


def units_of(verdict: UnitVerdict) -> tuple[int, ...]:
    return tuple(one.unit for one in verdict.touches)


@pytest.mark.parametrize("contrast", [3.0, 50.0])
def test_shapes_on_units_are_those_units_with_their_contrast(model: SheetModel, contrast: float) -> None:
    found = snapped(model, pieces(TOUCHED, 30.0), TOUCHED, contrast=contrast)
    assert units_of(found) == TOUCHED
    assert not found.flagged
    assert found.degrees_of_freedom == 101
    assert [one.contrast for one in found.touches] == pytest.approx([contrast] * 3, rel=0.25)


def test_a_shape_on_two_units_is_the_one_that_explains_the_frame(model: SheetModel) -> None:
    shapes = pieces(TOUCHED)
    shapes[0, 1] += 0.55 * (shapes[2, 1] - shapes[1, 1])  # most of it lies on the next unit
    assert np.argmax(unit_shares(ShapeVerdict((), 1.0, 1, 1.0, 0.01, 1, 0.0, pieces=shapes[:1],
                                             likely=((1.0, shapes[:1]),)).map(GRID), GRID)) == 18  # fmt: skip
    assert units_of(snapped(model, shapes, (18, 60, 61))) == TOUCHED


def test_what_the_network_shows_beside_the_shapes_is_decided_by_the_frame(model: SheetModel) -> None:
    assert units_of(snapped(model, pieces((17, 60)), (17, 60, 61))) == TOUCHED
    assert units_of(snapped(model, pieces(TOUCHED), (17, 60, 61, 100))) == TOUCHED


def test_wrong_units_are_flagged(model: SheetModel) -> None:
    found = snapped(model, pieces((17, 60)), (17, 60))
    assert units_of(found) == (17, 60)
    assert found.flagged
    assert found.p_value < 1e-6


def test_rows_that_are_missing_say_nothing(model: SheetModel) -> None:
    found = snapped(model, pieces(TOUCHED), TOUCHED, gone=(3, 9))
    assert units_of(found) == TOUCHED
    assert found.degrees_of_freedom == int((~rows_of((3, 9))).sum()) - 3
    assert not found.flagged


def test_nothing_touched_is_no_unit_and_too_many_are_said() -> None:
    few = np.arange(GRID.n_units) < 6
    assert too_many(few) == ""
    assert "7 units" in too_many(np.arange(GRID.n_units) < 7)
