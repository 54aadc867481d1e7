"""How the nodes of a unit divide, whatever the sheet's shape: worked out once a mesh, and used at every deformation."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.fem.contacts import Contacts
from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.unit_grid.unit_mesh import UnitMesh

MESHES_KEPT: Final = 8
"""Meshes with their contacts whose divisions are kept while the process runs."""


@dataclass(frozen=True, slots=True, eq=False)
class UnitNodes:
    """One unit's n unknowns: nodes that it shares and its electrodes, b together, then nodes that it has alone."""

    elements: Index
    """(e,)"""
    slot: Index
    """(e * 81,) where each number of the elements' blocks goes in an (n, n) matrix."""
    size: int
    border: int
    dofs: Index
    """(b,) places in the skeleton's numbering; electrode l is at s + l."""
    pieces: tuple[tuple[int, Index, int], ...]
    """The pieces of contact on it: number, (9,) unknowns under it, unknown of its electrode."""

    def assembled(self, stiffness: Array) -> Array:
        """Return the (n, n) S of the unit without contacts, of blocks (n_elements, 9, 9) for 1 S/m."""
        numbers = np.bincount(self.slot, stiffness[self.elements].ravel(), self.size**2)
        return np.asarray(numbers.reshape(self.size, self.size))


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
    shared = place[nodes] >= 0
    ordered = np.concatenate([nodes[shared], nodes[~shared]])
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


@lru_cache(maxsize=MESHES_KEPT * N_ELECTRODES * 2)
def near_contacts(unit: UnitNodes) -> tuple[UnitNodes, Index]:
    """Return a unit without nodes that it has alone and no contact lies on, and the order that puts them last.

    The unit that is left has no elements of its own: its stiffness comes from the whole one's.
    """
    kept = np.zeros(unit.size, dtype=np.bool_)
    kept[: unit.border] = True
    for _, own, _ in unit.pieces:
        kept[own] = True
    order = np.argsort(~kept, kind="stable")
    place = np.empty(unit.size, dtype=np.intp)
    place[order] = np.arange(unit.size)
    none = np.zeros(0, dtype=np.intp)
    pieces = tuple((piece, place[own], int(place[terminal])) for piece, own, terminal in unit.pieces)
    return UnitNodes(none, none, int(kept.sum()), unit.border, unit.dofs, pieces), order
