"""One fixed mesh for touches anywhere, its elements' middles eliminated.

Touches do not move the mesh; elements that their borders cut get blocks of their own (:mod:`eitskin_sim.kinks`). So the
sheet is assembled and inverted once a deformation, and all touch sets share that. ::

    o---o---o      a biquadratic element's middle node is its own affair: eight nodes remain, and the electrode
    |       |      where the element lies under a contact; 3,300 of 4,300 nodes of the sheet
    o   .   o
    |       |
    o---o---o
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np

from eitskin_proto.table import N_ELECTRODES
from eitskin_sim.bend import metric
from eitskin_sim.forward import Contacts, System, assemble
from eitskin_sim.mesh import Array, Index, TensorMesh
from eitskin_sim.meshing import electrode_lines
from eitskin_sim.parts import Bend, Electrodes, Sheet

ELEMENT_MM: Final = 3.5
"""The largest element."""

MIDDLE: Final = 4
"""Place of an element's middle among its nine nodes."""

KEPT: Final = np.array([0, 1, 2, 3, 5, 6, 7, 8, 9])
"""Places of the eight other nodes, and the electrode after them."""


@dataclass(frozen=True, slots=True)
class FreeMesh:
    """A mesh, and how its remaining unknowns are numbered: nodes, then the sixteen electrodes."""

    mesh: TensorMesh
    dofs: Index
    """(n_elements, 9) of each element's eight outer nodes and its electrode; -1 where it lies under none."""
    sharing: Index
    """(n_dofs,) how many elements have each; electrodes one more, so that they never count as inside."""
    n_nodes: int
    """Outer nodes."""
    lines: Index
    """(nx + 2,) where each upright line of nodes begins, with the middles of sides to its right, and the end."""


def free_lines(extent_mm: float, edges_mm: list[float], size_mm: float) -> Array:
    """Return even lines between the contacts' edges, no further apart than a size, mm."""
    fixed = np.unique(np.round([0.0, extent_mm, *edges_mm], 9))
    parts = [np.linspace(a, b, int(np.ceil((b - a) / size_mm - 1e-9)), endpoint=False) for a, b in pairwise(fixed)]
    return np.append(np.concatenate(parts), extent_mm)


@lru_cache(maxsize=4)
def free_mesh(size_mm: float = ELEMENT_MM) -> FreeMesh:
    """Return the default sheet's mesh for touches anywhere."""
    sheet, electrodes = Sheet(), Electrodes()
    x, y = electrode_lines(sheet, electrodes)
    mesh = TensorMesh(
        free_lines(sheet.size_mm[0], [at for at, _ in x], size_mm),
        free_lines(sheet.size_mm[1], [at for at, _ in y], size_mm),
    )
    middles = mesh.element_nodes[:, MIDDLE]
    outer = np.setdiff1d(np.arange(mesh.n_nodes), middles)
    place = np.full(mesh.n_nodes, -1)
    row, column = np.divmod(outer, 2 * mesh.shape[1] + 1)
    place[outer[np.lexsort((row, column))]] = np.arange(len(outer))
    column = np.sort(column)
    contacts = assemble(mesh, sheet, electrodes).contacts
    terminal = np.full(mesh.n_elements, -1)
    terminal[contacts.element] = len(outer) + contacts.electrode
    dofs = np.column_stack([place[mesh.element_nodes[:, KEPT[:8]]], terminal])
    sharing = np.bincount(dofs[dofs >= 0], minlength=len(outer) + N_ELECTRODES)
    sharing[len(outer) :] += 1
    lines = np.searchsorted(column, np.arange(0, 2 * mesh.shape[1] + 2, 2))
    return FreeMesh(mesh, dofs, sharing, len(outer), np.append(lines, len(outer)))


def free_system(bend: Bend, size_mm: float = ELEMENT_MM) -> System:
    """Return the default sheet's system at one bend."""
    sheet = Sheet()
    return assemble(free_mesh(size_mm).mesh, sheet, Electrodes(), lambda xy: metric(bend, sheet, xy))


def with_contacts(blocks: Array, elements: Index, density: Array, contacts: Contacts) -> Array:
    """Return (n, 10, 10) blocks of elements with their contacts; the electrode is the tenth unknown.

    Args:
        blocks: (n, 9, 9) S.
        elements: (n,) which elements.
        density: (m,) S/m^2 of every piece of contact, or (n,) of each element's own where that is given.
        contacts: The system's.
    """
    found = np.zeros((len(blocks), 10, 10))
    found[:, :9, :9] = blocks
    piece = np.full(int(max(elements.max(initial=0), contacts.element.max())) + 1, -1)
    piece[contacts.element] = np.arange(len(contacts.element))
    own = piece[elements]
    rows = np.flatnonzero(own >= 0)
    own = own[rows]
    kappa = density[rows] if len(density) == len(blocks) else density[own]
    found[rows, :9, :9] += kappa[:, None, None] * contacts.mass_m2[own]
    found[rows, :9, 9] -= kappa[:, None] * contacts.load_m2[own]
    found[rows, 9, :9] -= kappa[:, None] * contacts.load_m2[own]
    found[rows, 9, 9] += kappa * contacts.area_m2[own]
    return found


def without_middle(blocks: Array) -> Array:
    """Return (n, 9, 9) blocks of the eight outer nodes and the electrode, from (n, 10, 10)."""
    column = blocks[:, KEPT, MIDDLE]
    kept = blocks[:, KEPT[:, None], KEPT]
    return np.asarray(kept - column[:, :, None] * (column / blocks[:, MIDDLE, MIDDLE, None])[:, None, :])
