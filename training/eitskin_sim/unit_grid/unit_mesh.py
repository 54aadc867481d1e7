"""Meshes whose lines stand on the borders of units, so that a touched unit has its true outline."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_sim.fem.mesh import Array, Index, TensorMesh
from eitskin_sim.fem.meshing import electrode_lines, lines_between
from eitskin_sim.scene.parts import Electrodes, Sheet

UNIT_STEPS: Final = (0.06, 0.2, 0.48, 0.2, 0.06)
"""Elements across a unit, as shares of its side: fine at the borders, whose corners are weak singularities of a touch.

Against a converged mesh a touch's dV is off by 0.1 % (interior) to 0.6 % (under a contact); even steps: 0.35 %."""

SNAP: Final = 0.25
"""A line this near to a contact's edge, as a share of the unit's side, moves onto it."""


@dataclass(frozen=True, slots=True, eq=False)
class UnitMesh:
    """A mesh with lines on the units' borders, and how its nodes divide."""

    mesh: TensorMesh
    unit_of_element: Index
    """(n_elements,)"""
    skeleton: Index
    """(s,) nodes on lines between units."""
    shape: tuple[int, int]
    """Rows and columns of units."""

    @property
    def n_units(self) -> int:
        """How many units there are."""
        return self.shape[0] * self.shape[1]


def unit_lines(extent_mm: float, count: int, edges_mm: Sequence[float], refine: int = 1) -> Array:
    """Return mesh lines across ``count`` units, on their borders and on contacts' edges.

    Args:
        extent_mm: The sheet's length or width.
        count: Units side by side.
        edges_mm: Where lines must be.
        refine: Each element is cut into so many.
    """
    side = extent_mm / count
    found: list[float] = []
    for k in range(count):
        lines = k * side + side * np.concatenate([[0.0], np.cumsum(UNIT_STEPS)])
        free = list(range(1, len(UNIT_STEPS)))
        for edge in edges_mm:
            if not lines[0] + 1e-6 < edge < lines[len(UNIT_STEPS)] - 1e-6:
                continue
            nearest = min(free, key=lambda i: abs(lines[i] - edge), default=None)
            if nearest is not None and abs(lines[nearest] - edge) < SNAP * side:
                lines[nearest] = edge
                free.remove(nearest)
            else:
                lines = np.append(lines, edge)
        found += np.sort(lines).tolist()
    whole = np.unique(np.round(found, 9))
    parts = np.linspace(whole[:-1], whole[1:], refine, endpoint=False, axis=-1)
    return np.append(parts.ravel(), extent_mm)


def unit_mesh(sheet: Sheet, electrodes: Electrodes, shape: tuple[int, int], refine: int = 1) -> UnitMesh:
    """Return the mesh that rows and columns of units need.

    Args:
        sheet: The flat layer.
        electrodes: On its border.
        shape: Rows and columns of units.
        refine: Multiplies the elements along each direction.
    """
    rows, columns = shape
    x, y = electrode_lines(sheet, electrodes)
    between = lines_between(sheet, electrodes)
    mesh = TensorMesh(
        unit_lines(sheet.size_mm[0], columns, sorted({*(at for at, _ in x), *between[0]}), refine),
        unit_lines(sheet.size_mm[1], rows, sorted({*(at for at, _ in y), *between[1]}), refine),
    )
    x_borders = np.linspace(0.0, sheet.size_mm[0], columns + 1)
    y_borders = np.linspace(0.0, sheet.size_mm[1], rows + 1)
    column = np.searchsorted(x_borders, mesh.centres_mm[:, 0]) - 1
    row = np.searchsorted(y_borders, mesh.centres_mm[:, 1]) - 1
    first = np.full(mesh.n_nodes, rows * columns)
    last = np.full(mesh.n_nodes, -1)
    unit = row * columns + column
    np.minimum.at(first, mesh.element_nodes, unit[:, None])
    np.maximum.at(last, mesh.element_nodes, unit[:, None])
    return UnitMesh(mesh, unit, np.flatnonzero(first != last), shape)
