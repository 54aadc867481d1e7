"""A bent sheet cut along the borders of its units, each unit condensed onto its shared nodes.

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

The division of a unit's nodes is the same at every shape of the sheet, so it is computed once a mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array, Index
from eitskin_sim.devices.device import Device, ideal
from eitskin_sim.fem.contacts import Contacts, check_apart
from eitskin_sim.fem.forward import System, assemble
from eitskin_sim.fem.mesh import TensorMesh
from eitskin_sim.fem.meshing import electrode_lines, lines_between
from eitskin_sim.scene.bend import metric
from eitskin_sim.scene.parts import Bend, Electrodes, Sheet

UNIT_STEPS: Final = (0.06, 0.2, 0.48, 0.2, 0.06)
"""Elements across a unit, as shares of its side: fine at the borders, whose corners are weak singularities of a touch.

Against a converged mesh a touch's dV is off by 0.1 % (interior) to 0.6 % (under a contact); even steps: 0.35 %."""

SNAP_SHARE: Final = 0.25
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


def unit_lines(extent_mm: float, count: int, edges_mm: Sequence[float]) -> Array:
    """Return mesh lines across ``count`` units, on their borders and on contacts' edges.

    Args:
        extent_mm: The sheet's length or width.
        count: Units side by side.
        edges_mm: Where lines must be.
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
            if nearest is not None and abs(lines[nearest] - edge) < SNAP_SHARE * side:
                lines[nearest] = edge
                free.remove(nearest)
            else:
                lines = np.append(lines, edge)
        found += np.sort(lines).tolist()
    return np.append(np.unique(np.round(found, 9))[:-1], extent_mm)


def unit_mesh(sheet: Sheet, electrodes: Electrodes, shape: tuple[int, int]) -> UnitMesh:
    """Return the mesh that rows and columns of units need.

    Args:
        sheet: The flat layer.
        electrodes: On its border.
        shape: Rows and columns of units.
    """
    rows, columns = shape
    x, y = electrode_lines(sheet, electrodes)
    between = lines_between(sheet, electrodes)
    mesh = TensorMesh(
        unit_lines(sheet.size_mm[0], columns, sorted({*(at for at, _ in x), *between[0]})),
        unit_lines(sheet.size_mm[1], rows, sorted({*(at for at, _ in y), *between[1]})),
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


MESHES_KEPT: Final = 8
"""Meshes with their contacts whose divisions are kept while the process runs."""


@dataclass(frozen=True, slots=True, eq=False)
class UnitNodes:
    """One unit's n unknowns: b that it shares and its electrodes, nodes alone under its contacts, then all others."""

    elements: Index
    """(e,)"""
    slot: Index
    """(e * 81,) where each number of the elements' blocks goes in an (n, n) matrix."""
    size: int
    border: int
    """b"""
    near: int
    """Unknowns before the others."""
    dofs: Index
    """(b,) places in the skeleton's numbering; electrode l is at s + l."""
    pieces: tuple[tuple[int, Index, int], ...]
    """The pieces of contact on it: number, (9,) unknowns under it, unknown of its electrode."""


def nodes_of_units(parts: UnitMesh, contacts: Contacts) -> tuple[UnitNodes, ...]:
    """Return how the unknowns of each unit divide."""
    element, electrode = (np.ascontiguousarray(one, dtype=np.intp) for one in (contacts.element, contacts.electrode))
    return _divided(parts, element.tobytes(), electrode.tobytes())


@lru_cache(maxsize=MESHES_KEPT)
def _divided(parts: UnitMesh, element: bytes, electrode: bytes) -> tuple[UnitNodes, ...]:
    place = np.full(parts.mesh.n_nodes, -1)
    place[parts.skeleton] = np.arange(len(parts.skeleton))
    under = np.frombuffer(element, dtype=np.intp), np.frombuffer(electrode, dtype=np.intp)
    return tuple(_nodes(unit, parts, place, *under) for unit in range(parts.n_units))


def _nodes(unit: int, parts: UnitMesh, place: Index, element: Index, electrode: Index) -> UnitNodes:
    elements = np.flatnonzero(parts.unit_of_element == unit)
    nodes = np.unique(parts.mesh.element_nodes[elements])
    pieces = np.flatnonzero(np.isin(element, elements))
    terminals = np.unique(electrode[pieces])
    shared, under = place[nodes] >= 0, np.isin(nodes, parts.mesh.element_nodes[element[pieces]])
    ordered = np.concatenate([nodes[shared], nodes[~shared & under], nodes[~shared & ~under]])
    kept = int(np.count_nonzero(shared))
    order = np.argsort(ordered)

    def local(numbers: Index) -> Index:
        found = order[np.searchsorted(ordered, numbers, sorter=order)]
        return np.asarray(np.where(found < kept, found, found + len(terminals)))

    size = len(nodes) + len(terminals)
    at = local(parts.mesh.element_nodes[elements])
    return UnitNodes(
        elements=elements,
        slot=(at[:, :, None] * size + at[:, None, :]).ravel(),
        size=size,
        border=kept + len(terminals),
        near=int(np.count_nonzero(shared | under)) + len(terminals),
        dofs=np.concatenate([place[nodes[shared]], len(parts.skeleton) + terminals]),
        pieces=tuple(
            (
                int(piece),
                local(parts.mesh.element_nodes[element[piece]]),
                kept + int(np.searchsorted(terminals, electrode[piece])),
            )
            for piece in pieces
        ),
    )


ZERO_EIGENVALUE: Final = 1e-13
"""Relative size under which an eigenvalue of a unit is its one zero: a constant potential passes no current."""


class Unit:
    """One unit at a bend, without the nodes that it has alone and no contact lies on: they serve all conductivities.

    Args:
        nodes: Its unknowns.
        system: At the bend.

    Raises:
        ValueError: The sheet does not conduct.
    """

    def __init__(self, nodes: UnitNodes, system: System) -> None:
        self.dofs, self._nodes, self._contacts = nodes.dofs, nodes, system.contacts
        numbers = np.bincount(nodes.slot, system.stiffness[nodes.elements].ravel(), nodes.size**2)
        self._near = without(np.asarray(numbers.reshape(nodes.size, nodes.size), dtype=np.float64), nodes.near)

    @property
    def under_contact(self) -> bool:
        """Whether a contact lies on it: its stiffness is then not in proportion to its conductivity."""
        return bool(self._nodes.pieces)

    def at(self, sigma: float) -> Array:
        """Return its (b, b) S at a conductivity, S/m."""
        whole, contacts = sigma * self._near, self._contacts
        density = contacts.density(np.full(len(contacts.element), sigma)) if self._nodes.pieces else np.zeros(0)
        for piece, own, terminal in self._nodes.pieces:
            whole[own[:, None], own] += density[piece] * contacts.mass_m2[piece]
            whole[own, terminal] -= density[piece] * contacts.load_m2[piece]
            whole[terminal, own] -= density[piece] * contacts.load_m2[piece]
            whole[terminal, terminal] += density[piece] * contacts.area_m2[piece]
        return without(whole, self._nodes.border)


@lru_cache(maxsize=8)
def _nominal_mesh(skin: Skin) -> UnitMesh:
    return unit_mesh(ideal(skin).sheet, ideal(skin).electrodes, skin.grid.units)


def unit_system(bend: Bend, device: Device | None = None, skin: Skin = PAPER) -> tuple[UnitMesh, System]:
    """Return a skin's mesh, whatever the device, and a device's system at one bend; None is what the skin states."""
    parts, true = _nominal_mesh(skin), device or ideal(skin)
    system = assemble(parts.mesh, true.sheet, true.electrodes, lambda xy: metric(bend, true.sheet, xy))
    check_apart(system.contacts)
    return parts, system


def without(whole: Array, kept: int) -> Array:
    """Return the (kept, kept) Schur complement of a symmetric matrix, its last unknowns eliminated.

    Raises:
        ValueError: Its last unknowns are not held by the others.
    """
    if kept == len(whole):
        return whole
    _, inside, failed = lapack.dposv(whole[kept:, kept:], whole[kept:, :kept], lower=0)
    if failed:
        raise ValueError("a unit's stiffness is not positive definite; expected a conducting sheet")
    reduced = whole[:kept, :kept] - whole[:kept, kept:] @ inside
    return np.asarray((reduced + reduced.T) / 2)


def assemble_skeleton(units: Sequence[Unit], stiffness: Sequence[Array], n_dofs: int) -> Array:
    """Return the dense (s + 16, s + 16) S of the whole sheet, from the (b, b) of every unit."""
    total: npt.NDArray[np.float64] = np.zeros((n_dofs, n_dofs), order="F")
    for unit, own in zip(units, stiffness, strict=True):
        total[np.ix_(unit.dofs, unit.dofs)] += own
    total[-N_ELECTRODES:, -N_ELECTRODES:] += ground(total)
    return total


def square_root(conductance: Array) -> Array:
    """Return (b, r) L with L L^T = S, of a unit's (b, b) S or of what touching adds to it; r is the rank of S."""
    value, vector = np.linalg.eigh(conductance)
    kept = value > ZERO_EIGENVALUE * value[-1]
    return np.asarray(vector[:, kept] * np.sqrt(value[kept]))


def ground(stiffness: Array) -> float:
    """Return the conductance, S, that ties the electrodes' mean to zero without changing any adjacent drive."""
    return float(np.diag(stiffness)[-N_ELECTRODES:].mean() / N_ELECTRODES)
