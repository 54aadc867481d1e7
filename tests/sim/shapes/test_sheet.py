"""Touches anywhere with parameters: their derivatives, and what they should read by symmetry and by another solver."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt
import pytest

from eitskin_proto.sensor.table import TABLE
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.freeform.mesh import shared_mesh
from eitskin_sim.freeform.sheet import inverted_sheet
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.shapes import Ellipse, Rect
from eitskin_sim.shapes.parameters import NAMES, free, parameters_of, pieces_of
from eitskin_sim.shapes.sheet import TouchedSheet

Array = npt.NDArray[np.float64]

SIZE_MM = 6.0
BEND = Bend(angle_deg=90.0, stretch_along=1.05, nonuniformity=0.05)

MIXED = np.array(
    [
        [0, 40.3, 33.1, 10.0, 12.0, 17.0, 50.0, 0.0],
        [0, 101.2, 60.7, 14.0, 22.0, 30.0, 0.3, 0.0],
        [2, 60.4, 71.3, 16.0, 12.0, 20.0, 0.4, 3.0],
        [1, 123.1, 29.3, 11.0, 11.0, 0.0, 5.0, 0.0],
        [2, 21.7, 69.2, 15.0, 13.0, 60.0, 20.0, 2.0],
    ]
)


@lru_cache(maxsize=2)
def sheet(bend: Bend = BEND) -> TouchedSheet:
    return TouchedSheet(inverted_sheet(bend, SIZE_MM), shared_mesh(SIZE_MM))


def volts(pieces: Array, bend: Bend = BEND) -> Array:
    return sheet(bend).solve(pieces).voltages_V


def test_derivatives_are_difference_quotients_of_the_voltages() -> None:
    own = free(MIXED)
    found, _ = sheet().jacobian(sheet().solve(MIXED), own)
    values, step = parameters_of(MIXED), 1e-4
    for column, (row, parameter) in zip(found.T, np.argwhere(own).tolist(), strict=True):
        ends = []
        for sign in (-1.0, 1.0):
            moved = values.copy()
            moved[row, parameter] += sign * step
            ends.append(volts(pieces_of(MIXED[:, 0], moved)))
        quotient = (ends[1] - ends[0]) / (2.0 * step)
        # The border's rule has corners where cells of an element begin to be cut: 1e-3 there, 1e-5 elsewhere.
        error = np.linalg.norm(column - quotient) / np.linalg.norm(quotient)
        assert error < 5e-3, (row, NAMES[parameter], error)


def test_a_touch_that_is_not_there_reads_as_the_untouched_sheet() -> None:
    assert np.array_equal(volts(np.zeros((0, 8))), sheet().untouched_V)
    faint = MIXED[:1].copy()
    faint[:, 6] = np.exp(1e-4)
    change = volts(faint) / sheet().untouched_V - 1.0
    assert 0.0 < np.abs(change).max() < 1e-4


def test_faint_touches_far_apart_add_up_and_strong_ones_do_not() -> None:
    def excess(log: float) -> float:
        pieces = MIXED[[0, 3]].copy()
        pieces[:, 6] = np.exp(log)
        before = sheet().untouched_V
        apart = sum(volts(one[None]) - before for one in pieces)
        return float(np.linalg.norm(volts(pieces) - before - apart) / np.linalg.norm(apart))

    assert excess(1e-3) < 1e-5
    assert excess(3.0) > 1e-3


def test_overlapping_touches_of_one_kind_are_one() -> None:
    left = np.array([[0, 60.0, 50.0, 20.0, 12.0, 0.0, 50.0, 0.0]])
    right = np.array([[0, 68.0, 50.0, 20.0, 12.0, 0.0, 50.0, 0.0]])
    both = np.array([[0, 64.0, 50.0, 28.0, 12.0, 0.0, 50.0, 0.0]])
    before = sheet().untouched_V
    one, two = volts(both) - before, volts(np.vstack([left, right])) - before
    assert np.linalg.norm(one - two) < 0.01 * np.linalg.norm(one)
    assert np.linalg.norm(one - volts(left) + before) > 0.1 * np.linalg.norm(one)


def test_a_mirrored_touch_reads_as_the_mirrored_electrodes_do() -> None:
    # The flat sheet is the same from behind: x -> L - x sends electrode n, counted along the border, to 4 - n.
    mirrored = MIXED.copy()
    mirrored[:, 1], mirrored[:, 5] = 150.0 - mirrored[:, 1], -mirrored[:, 5]
    flat = sheet(Bend())
    there, here = flat.solve(MIXED).response, flat.solve(mirrored).response
    image = (4 - np.arange(16)) % 16
    differences = np.eye(16) - 1.0 / 16.0
    one, other = differences @ there @ differences, differences @ here[np.ix_(image, image)] @ differences
    assert np.allclose(one, other, rtol=0.0, atol=1e-8 * np.abs(one).max())
    assert len(TABLE) == 104


@pytest.mark.slow
@pytest.mark.parametrize("contrast", [0.3, 5.0, 50.0])
@pytest.mark.parametrize("border_mm", [0.0, 3.0])
def test_voltages_are_those_of_a_scene(contrast: float, border_mm: float) -> None:
    """Another mesh, which follows the touch; this one's of 6 mm is 2 to 6 % of dV off, and would be 100 % by a sign."""
    touches = (
        Touch((Rect(50.3, 41.2, 66.3, 57.2),), contrast=contrast, border_mm=border_mm),
        Touch((Ellipse(100.4, 61.2, 20.0, 14.0, 30.0),), contrast=contrast, border_mm=border_mm),
    )
    pieces = np.array(
        [[0, 58.3, 49.2, 16.0, 16.0, 0.0, contrast, border_mm], [2, 100.4, 61.2, 20.0, 14.0, 30.0, contrast, border_mm]]
    )
    scene = Scene(bend=BEND, touches=touches, element_size_mm=3.0)
    true = solve_scene(scene).voltages / solve_scene(scene.untouched()).voltages - 1.0
    found = volts(pieces) / sheet().untouched_V - 1.0
    assert np.linalg.norm(found - true) < 0.1 * np.linalg.norm(true)


def test_a_sheet_solved_whole_reads_as_one_solved_where_it_is_touched(monkeypatch: pytest.MonkeyPatch) -> None:
    pieces = np.array([[0, 60.0, 45.0, 50.0, 40.0, 10.0, 50.0, 0.0], [0, 120.0, 70.0, 20.0, 10.0, 0.0, 0.3, 0.0]])
    own = sheet()
    found = []
    for large in (0, 10_000):
        monkeypatch.setattr("eitskin_sim.shapes.sheet.WHOLE_SOLVE_NODES", large)
        found.append(own.solve(pieces))
    whole, part = found
    assert np.array_equal(whole.dofs, part.dofs)
    assert np.allclose(whole.voltages_V, part.voltages_V, rtol=1e-9, atol=1e-12)
    wanted = free(pieces)
    rates = [own.jacobian(one, wanted)[0] for one in found]
    assert np.allclose(*rates, rtol=1e-7, atol=1e-9)
