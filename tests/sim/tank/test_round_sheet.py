import numpy as np
import pytest

from eitskin_proto.sensor.table import TABLE
from eitskin_proto.skin.parts import Map, Outline, Ring
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import Skin
from eitskin_sim.scene.parts import Bend
from eitskin_sim.tank.round_sheet import RoundSheet

DIAMETER_MM = 100.0


@pytest.fixture(scope="module")
def sheet() -> RoundSheet:
    arc = tuple((np.pi * DIAMETER_MM / 16 * np.arange(16)).tolist())  # the first electrode is at the rightmost point
    ring = Ring(contact="edge", arc_length_mm=Quantity(arc), size_mm=Quantity(5.0))
    return RoundSheet(Skin("round", Outline("disc", (DIAMETER_MM, DIAMETER_MM)), electrodes=ring, map=Map((30, 36))))


def turned(voltages: np.ndarray, electrodes: int) -> np.ndarray:
    """Return the rows that read the same once the ring is turned by some electrodes."""
    number = {(int(k), int(m)): row for row, (k, m) in enumerate(TABLE)}
    pairs = np.sort((TABLE.astype(int) + electrodes) % 16, axis=1)
    return voltages[[number[int(k), int(m)] for k, m in pairs]]


def test_a_disc_turned_by_one_electrode_reads_the_same(sheet: RoundSheet) -> None:
    voltages = sheet.voltages()
    assert np.abs(turned(voltages, 1) / voltages - 1).max() < 2e-3  # the square's mesh has four corners


def test_a_disc_bent_another_way_reads_what_the_turned_one_does(sheet: RoundSheet) -> None:
    along, across = sheet.voltages(Bend(stretch_along=1.1)), sheet.voltages(Bend(stretch_across=1.1))
    assert np.abs(along / sheet.voltages() - 1).max() > 0.05
    assert np.abs(turned(across, 4) / along - 1).max() < 1e-4


def test_the_jacobian_of_pixels_is_the_slope_of_a_touch_and_zero_outside(sheet: RoundSheet) -> None:
    jacobian, inside, grid = sheet.relative_jacobian(), sheet.inside, sheet.skin.grid
    assert not jacobian[:, ~inside].any()
    assert inside.mean() == pytest.approx(np.pi / 4, abs=0.02)
    x, y, radius, contrast = 62.0, 35.0, 8.0, 1.02
    change = np.log(sheet.voltages(touches=[(x, y, radius, contrast)]) / sheet.voltages())
    steps = (np.arange(12) + 0.5) / 12 - 0.5
    within = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) * grid.pixel_mm
    points = grid.pixel_centres_mm().reshape(-1, 1, 2) + within
    share = (np.linalg.norm(points - (x, y), axis=-1) < radius).mean(axis=1)
    slope = jacobian @ share * np.log(contrast)
    assert np.linalg.norm(slope - change) < 0.03 * np.linalg.norm(change)
