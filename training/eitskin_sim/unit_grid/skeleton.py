"""A bent sheet cut along the borders of its units, each unit condensed onto what it shares with others.

Stiffness adds up over elements, so a unit's inside can be eliminated once for each conductivity it may have. What
remains is the skeleton: nodes on the lines between units, and the sixteen electrodes. ::

    +-----o-----o-----+      o  lines between units: 1,500 nodes of 5,900 at the default size
    |     o     o     |      .  insides and the sheet's border: eliminated, unit by unit
    |  .  o  .  o  .  |
    o o o o o o o o o o      S = sum over units of S_u(sigma_u), exactly
    |  .  o  .  o  .  |

Mesh lines stand on the units' borders, so a touched unit has its true outline. A contact may lie on two units; its
electrode is then in both. A face contact's conductance depends on the conductivity above it, and so comes with each
unit's S_u.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.devices.device import Device, ideal
from eitskin_sim.devices.loose_contacts import system_on
from eitskin_sim.fem.forward import System
from eitskin_sim.fem.mesh import Array, Index, Metric, TensorMesh
from eitskin_sim.fem.meshing import electrode_lines
from eitskin_sim.scene.bend import metric
from eitskin_sim.scene.parts import Bend, Electrodes, Sheet

UNIT_STEPS: Final = (0.06, 0.2, 0.48, 0.2, 0.06)
"""Elements across a unit, as shares of its side: fine at the borders, whose corners are weak singularities of a touch.

Against a converged mesh a touch's dV is off by 0.1 % (interior) to 0.6 % (under a contact); even steps: 0.35 %."""

SNAP: Final = 0.25
"""A line this near to a contact's edge, as a share of the unit's side, moves onto it."""

NULL: Final = 1e-13
"""Relative size under which an eigenvalue of a unit is its one zero: a constant potential passes no current."""


@dataclass(frozen=True, slots=True)
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


@dataclass(frozen=True, slots=True)
class Condensed:
    """One unit at some conductivities.

    Args:
        dofs: (b,) places in the skeleton's numbering; electrode l is at s + l.
        schur: (conductivities, b, b) S.
    """

    dofs: Index
    schur: Array


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
    coarse = np.unique(np.round(found, 9))
    parts = np.linspace(coarse[:-1], coarse[1:], refine, endpoint=False, axis=-1)
    return np.append(parts.ravel(), extent_mm)


def unit_mesh(sheet: Sheet, electrodes: Electrodes, shape: tuple[int, int], refine: int = 1) -> UnitMesh:
    """Return the mesh that rows and columns of units need; ``refine`` multiplies the elements along each direction."""
    rows, columns = shape
    x, y = electrode_lines(sheet, electrodes)
    mesh = TensorMesh(
        unit_lines(sheet.size_mm[0], columns, sorted({at for at, _ in x}), refine),
        unit_lines(sheet.size_mm[1], rows, sorted({at for at, _ in y}), refine),
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


@lru_cache(maxsize=4)
def _nominal_mesh(skin: Skin, refine: int) -> UnitMesh:
    return unit_mesh(ideal(skin).sheet, ideal(skin).electrodes, skin.grid.units, refine)


def unit_system(
    bend: Bend, refine: int = 1, device: Device | None = None, skin: Skin = PAPER
) -> tuple[UnitMesh, System]:
    """Return a skin's mesh, whatever the device, and a device's system at one bend; None is what the skin states."""
    parts, true, nominal = _nominal_mesh(skin, refine), device or ideal(skin), ideal(skin).electrodes
    return parts, system_on(parts.mesh, true.sheet, true.electrodes, lambda xy: metric(bend, true.sheet, xy), nominal)


def unit_system_of(first: Metric, refine: int = 1, skin: Skin = PAPER) -> tuple[UnitMesh, System]:
    """Return a skin's mesh and the system of the sheet that it states, scaled to 1 S/m, at any metric."""
    parts, true = _nominal_mesh(skin, refine), ideal(skin)
    return parts, system_on(parts.mesh, true.sheet, true.electrodes, first, true.electrodes)


def condense_units(parts: UnitMesh, system: System, conductivities: Sequence[float]) -> list[Condensed]:
    """Return all units, each condensed at every one of some conductivities, S/m."""
    place = _place(parts)
    return [_condense(unit, parts, system, place, conductivities) for unit in range(parts.n_units)]


def condense_at(unit: int, parts: UnitMesh, system: System, conductivities: Sequence[float]) -> Condensed:
    """Return one unit, condensed at each of some conductivities, S/m."""
    return _condense(unit, parts, system, _place(parts), conductivities)


def _place(parts: UnitMesh) -> Index:
    """Return (n_nodes,) each node's place in the skeleton's numbering, -1 for those inside units."""
    place = np.full(parts.mesh.n_nodes, -1)
    place[parts.skeleton] = np.arange(len(parts.skeleton))
    return place


def _condense(unit: int, parts: UnitMesh, system: System, place: Index, conductivities: Sequence[float]) -> Condensed:
    elements = np.flatnonzero(parts.unit_of_element == unit)
    nodes = np.unique(parts.mesh.element_nodes[elements])
    pieces = np.flatnonzero(np.isin(system.contacts.element, elements))
    terminals = np.unique(system.contacts.electrode[pieces])
    shared = place[nodes] >= 0
    ordered = np.concatenate([nodes[shared], nodes[~shared]])
    kept = np.count_nonzero(shared)
    order = np.argsort(ordered)

    def local(numbers: Index) -> Index:
        found = order[np.searchsorted(ordered, numbers, sorter=order)]
        return np.asarray(np.where(found < kept, found, found + len(terminals)))

    size = len(nodes) + len(terminals)
    border = kept + len(terminals)
    at = local(parts.mesh.element_nodes[elements])
    stiffness = np.zeros((size, size))
    np.add.at(stiffness, (at[:, :, None], at[:, None, :]), system.stiffness[elements])
    under = [
        (
            piece,
            local(parts.mesh.element_nodes[system.contacts.element[piece]]),
            kept + int(np.searchsorted(terminals, system.contacts.electrode[piece])),
        )
        for piece in pieces
    ]
    schur = []
    for sigma in conductivities:
        whole = sigma * stiffness
        density = system.contacts.density(np.full(len(system.contacts.element), sigma))
        for piece, own, terminal in under:
            whole[np.ix_(own, own)] += density[piece] * system.contacts.mass_m2[piece]
            whole[own, terminal] -= density[piece] * system.contacts.load_m2[piece]
            whole[terminal, own] -= density[piece] * system.contacts.load_m2[piece]
            whole[terminal, terminal] += density[piece] * system.contacts.area_m2[piece]
        inside = cho_solve(cho_factor(whole[border:, border:]), whole[border:, :border])
        reduced = whole[:border, :border] - whole[:border, border:] @ inside
        schur.append((reduced + reduced.T) / 2)
    dofs = np.concatenate([place[nodes[shared]], len(parts.skeleton) + terminals])
    return Condensed(dofs=dofs, schur=np.array(schur))


def assemble_skeleton(units: Sequence[Condensed], which: int, n_dofs: int) -> Array:
    """Return the dense (s + 16, s + 16) S of the whole sheet, every unit at conductivity number ``which``."""
    total: npt.NDArray[np.float64] = np.zeros((n_dofs, n_dofs), order="F")
    for unit in units:
        total[np.ix_(unit.dofs, unit.dofs)] += unit.schur[which]
    total[-N_ELECTRODES:, -N_ELECTRODES:] += ground(total)
    return total


def square_root(conductance: Array) -> Array:
    """Return (b, r) L with L L^T = S, of a unit's (b, b) S or of what touching adds to it; r is the rank of S."""
    value, vector = np.linalg.eigh(conductance)
    kept = value > NULL * value[-1]
    return np.asarray(vector[:, kept] * np.sqrt(value[kept]))


def ground(stiffness: Array) -> float:
    """Return the conductance, S, that ties the electrodes' mean to zero without changing any adjacent drive."""
    return float(np.diag(stiffness)[-N_ELECTRODES:].mean() / N_ELECTRODES)
