"""One fixed mesh for touches anywhere on any device, its elements' middles eliminated.

Neither touches nor electrodes off their nominal places (:mod:`eitskin_sim.fem.contacts`) move the mesh;
elements that touches' borders cut get blocks of their own (:mod:`eitskin_sim.fem.borders.cut_touches`). So the sheet is
assembled and inverted once a deformation, and all touch sets share that. ::

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

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array, Index
from eitskin_sim.devices.device import ideal
from eitskin_sim.fem.contacts import Contacts, check_apart, contacts_of
from eitskin_sim.fem.forward import flat_metric
from eitskin_sim.fem.inverse import Lines, make_lines
from eitskin_sim.fem.mesh import TensorMesh
from eitskin_sim.fem.meshing import electrode_lines, lines_between
from eitskin_sim.scene.parts import Electrodes

ELEMENT_MM: Final = 3.5
"""The largest element."""

MIDDLE_NODE: Final = 4
"""Place of an element's middle among its nine nodes."""

KEPT_NODES: Final = np.array([0, 1, 2, 3, 5, 6, 7, 8, 9])
"""Places of the eight other nodes, and the electrode after them."""


@dataclass(frozen=True, slots=True, eq=False)
class SharedMesh:
    """A mesh, and how its remaining unknowns are numbered: by lines, electrodes in the middle one of theirs.

    Each is made once and is equal to itself alone, so that what is made of it can be kept by it.
    """

    mesh: TensorMesh
    dofs: Index
    """(n_elements, 9) of each element's eight outer nodes and its electrode; -1 where it lies under none."""
    sharing: Index
    """(n_dofs,) how many elements have each; electrodes one more, so that they never count as inside."""
    terminals: Index
    """(16,) the electrodes."""
    lines: Lines
    """Upright lines of nodes, with the middles of sides to their right and the electrodes over them."""


def even_lines(extent_mm: float, edges_mm: list[float], size_mm: float) -> Array:
    """Return even lines between the contacts' edges, no further apart than a size, mm."""
    fixed = np.unique(np.round([0.0, extent_mm, *edges_mm], 9))
    parts = [np.linspace(a, b, int(np.ceil((b - a) / size_mm - 1e-9)), endpoint=False) for a, b in pairwise(fixed)]
    return np.append(np.concatenate(parts), extent_mm)


@lru_cache(maxsize=4)
def shared_mesh(size_mm: float = ELEMENT_MM, electrodes: Electrodes | None = None, skin: Skin = PAPER) -> SharedMesh:
    """Return a skin's mesh for touches anywhere.

    Args:
        size_mm: The largest element.
        electrodes: Which elements have an unknown of which electrode; None is the skin's own, which the lines follow
            whatever it is.
        skin: The sheet and its electrodes as they are stated.

    Raises:
        ValueError: Two electrodes meet one element.
    """
    sheet, nominal = ideal(skin).sheet, ideal(skin).electrodes
    x, y = electrode_lines(sheet, nominal)
    between = lines_between(sheet, nominal)
    mesh = TensorMesh(
        even_lines(sheet.size_mm[0], [*(at for at, _ in x), *between[0]], size_mm),
        even_lines(sheet.size_mm[1], [*(at for at, _ in y), *between[1]], size_mm),
    )
    contacts = check_apart(contacts_of(mesh, sheet, electrodes or nominal, flat_metric))
    outer = np.setdiff1d(np.arange(mesh.n_nodes), mesh.element_nodes[:, MIDDLE_NODE])
    column = outer % (2 * mesh.shape[1] + 1)
    low, high = _spans(contacts, mesh.shape[1])
    wide = int(-(-(high - low).max() // 2))  # an electrode's lines are then three neighbours at most
    line = np.concatenate([column // 2 // wide, (low // wide + high // wide) // 2])
    order = np.lexsort((np.append(column, np.full(N_ELECTRODES, 2 * mesh.shape[1] + 1)), line))
    place = np.empty(len(order), dtype=np.intp)
    place[order] = np.arange(len(order))
    of_node = np.full(mesh.n_nodes, -1)
    of_node[outer] = place[: len(outer)]
    terminals = place[len(outer) :]
    terminal = np.full(mesh.n_elements, -1)
    terminal[contacts.element] = terminals[contacts.electrode]
    dofs = np.column_stack([of_node[mesh.element_nodes[:, KEPT_NODES[:8]]], terminal])
    sharing = np.bincount(dofs[dofs >= 0], minlength=len(order))
    sharing[terminals] += 1
    first = np.searchsorted(line[order], np.arange(line.max() + 2))
    return SharedMesh(mesh, dofs, sharing, terminals, make_lines(first, dofs))


def _spans(contacts: Contacts, columns: int) -> tuple[Index, Index]:
    """Return the first and the last upright line of elements' sides that each electrode's contact meets."""
    low, high = np.full(N_ELECTRODES, columns), np.zeros(N_ELECTRODES, dtype=np.intp)
    np.minimum.at(low, contacts.electrode, contacts.element % columns)
    np.maximum.at(high, contacts.electrode, contacts.element % columns + 1)
    return low, high


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
    if not len(rows):
        return found
    own = own[rows]
    kappa = density[rows] if len(density) == len(blocks) else density[own]
    found[rows, :9, :9] += kappa[:, None, None] * contacts.mass_m2[own]
    found[rows, :9, 9] -= kappa[:, None] * contacts.load_m2[own]
    found[rows, 9, :9] -= kappa[:, None] * contacts.load_m2[own]
    found[rows, 9, 9] += kappa * contacts.area_m2[own]
    return found


def without_middle(blocks: Array) -> Array:
    """Return (n, 9, 9) blocks of the eight outer nodes and the electrode, from (n, 10, 10)."""
    column = blocks[:, KEPT_NODES, MIDDLE_NODE]
    kept = blocks[:, KEPT_NODES[:, None], KEPT_NODES]
    return np.asarray(kept - column[:, :, None] * (column / blocks[:, MIDDLE_NODE, MIDDLE_NODE, None])[:, None, :])
