"""The inverse of a skeleton's stiffness, strip of units by strip of units: a tenth of a general inverse's work.

A strip holds the shared nodes of one column of units and of the line behind it, and the electrodes on it, so that only
neighbours meet and :mod:`eitskin_sim.fem.inverse` serves. Potentials are up to a constant: a node amid the sheet is
tied to the ground, and currents add up to 0. An electrode in its place costs two digits.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.fem.inverse import Lines, dense_inverse, make_lines
from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.unit_grid.skeleton import Condensed
from eitskin_sim.unit_grid.unit_mesh import UnitMesh
from eitskin_sim.unit_grid.unit_nodes import MESHES_KEPT

NEAR: Final = 1e-6
"""Of a unit's side: a node so near to a line between units lies on it."""


def inverse_by_strips(parts: UnitMesh, units: Sequence[Condensed]) -> tuple[list[Condensed], Array, Index]:
    """Return the inverse of an untouched skeleton's stiffness.

    Args:
        parts: The mesh.
        units: All, condensed at the sheet's conductivity first of all.

    Returns:
        The units with their unknowns numbered as the inverse has them, the (s + 16, s + 16) ohm, and which of its
        unknowns the sixteen electrodes are.

    Raises:
        ValueError: The stiffness is not positive definite.
    """
    most = max(len(unit.dofs) for unit in units)
    dofs = np.full((len(units), most), -1)
    blocks: Array = np.zeros((len(units), most, most))
    for into, block, unit in zip(dofs, blocks, units, strict=True):
        into[: len(unit.dofs)] = unit.dofs
        block[: len(unit.dofs), : len(unit.dofs)] = unit.schur[0]
    place, lines = _strips(parts, dofs.tobytes(), most)
    renumbered = [replace(unit, dofs=place[unit.dofs]) for unit in units]
    terminals = place[-N_ELECTRODES:]
    middle = int(lines.first[-1]) // 2
    return renumbered, dense_inverse(lines, blocks, (middle, float(blocks.max()))), terminals


@lru_cache(maxsize=MESHES_KEPT)
def _strips(parts: UnitMesh, dofs: bytes, most: int) -> tuple[Index, Lines]:
    """Return each unknown's place, and how the units' blocks make up those of the strips."""
    of_unit = np.frombuffer(dofs, dtype=np.intp).reshape(-1, most)
    strip = _strip_of_unknown(parts, of_unit)
    place = np.empty(len(strip), dtype=np.intp)
    place[np.argsort(strip, kind="stable")] = np.arange(len(strip))
    first = np.concatenate([[0], np.cumsum(np.bincount(strip))])
    return place, make_lines(first, np.where(of_unit >= 0, place[of_unit], -1))


def _strip_of_unknown(parts: UnitMesh, of_unit: Index) -> Index:
    rows, columns = parts.shape
    along, count = (0, columns) if columns >= rows else (1, rows)
    lines = (parts.mesh.x_lines_mm, parts.mesh.y_lines_mm)[along]
    at = parts.mesh.nodes_mm[parts.skeleton, along] / lines[-1] * count
    of_node = np.clip(np.ceil(at - NEAR).astype(np.intp) - 1, 0, count - 1)
    unit, position = np.nonzero(of_unit >= len(parts.skeleton))
    electrode = of_unit[unit, position] - len(parts.skeleton)
    own = unit % columns if along == 0 else unit // columns
    low, high = np.full(N_ELECTRODES, count), np.zeros(N_ELECTRODES, dtype=np.intp)
    np.minimum.at(low, electrode, own)
    np.maximum.at(high, electrode, own)
    wide = max(int((high - low).max()), 1)  # an electrode over three columns joins the first to the third
    return np.concatenate([of_node, low]) // wide
