"""The dense inverse by lines: what a general inverse says, for contacts as wide as any mesh makes them."""

import numpy as np
import pytest

from eitskin_sim.fem.inverse import solve_lines
from eitskin_sim.freeform.mesh import SharedMesh, shared_mesh
from eitskin_sim.freeform.sheet import inverted_sheet
from eitskin_sim.scene.parts import Bend

SIZE_MM = 8.0
BEND = Bend(angle_deg=60.0, axis_deg=15.0, stretch_along=1.05)


def stiffness(grid: SharedMesh, blocks: np.ndarray) -> np.ndarray:
    total = np.zeros((len(grid.sharing) + 1,) * 2)  # the last row and column take what belongs to no unknown
    np.add.at(total, (grid.dofs[:, :, None], grid.dofs[:, None, :]), blocks)
    return total[:-1, :-1]


# Currents that add up to zero: what ties the potential to the ground then passes none, and differences are defined.
def test_potentials_of_the_inverse_drive_the_currents_that_made_them() -> None:
    grid, sheet = shared_mesh(SIZE_MM), inverted_sheet(BEND, SIZE_MM)
    currents = np.random.default_rng(0).normal(size=(len(grid.sharing), 5))
    currents -= currents.mean(axis=0)
    back = stiffness(grid, sheet.before) @ (sheet.inverse @ currents)
    assert np.abs(back - currents).max() < 1e-9
    assert np.allclose(sheet.inverse, sheet.inverse.T, rtol=1e-9)


def test_a_sheet_is_solved_line_by_line_as_by_its_inverse() -> None:
    grid, sheet = shared_mesh(SIZE_MM), inverted_sheet(BEND, SIZE_MM)
    currents = np.random.default_rng(0).normal(size=(len(grid.sharing), 5))
    kept = currents.copy()
    found = solve_lines(grid.lines, sheet.before, sheet.ground, currents)
    assert np.allclose(found, sheet.inverse @ currents, rtol=1e-9, atol=1e-9 * np.abs(found).max())
    assert np.array_equal(currents, kept)
    with pytest.raises(ValueError, match="not positive definite"):
        solve_lines(grid.lines, -sheet.before, sheet.ground, currents)
