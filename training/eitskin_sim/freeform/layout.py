"""The layout of unknowns and numbers of the touched elements of a part, made once for all deformations.

A part is a touch, or several that share elements. It is cut into cells of a few elements a side; nodes are inside their
cell, inside the part on a border between cells, or on the part's outline. Eliminated in this order they cost a fraction
of what they cost at once, since cells know nothing of each other. The last of an outline is held at zero: a part passes
no current where all potentials are alike, so what it does to the others says all. ::

    elements --81 numbers each--> cells (inside | border) --> parts (between cells | outline) --> outlines

Cells and parts are fronts: squares of numbers that follow each other in one long buffer.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_sim.arrays import Index
from eitskin_sim.freeform.mesh import SharedMesh

MAX_ELEMENTS_PER_SIDE: Final = 5
"""The most elements along a cell's side."""


@dataclass(frozen=True, slots=True)
class Fronts:
    """Where the numbers of f squares go, and which of their unknowns are eliminated.

    Args:
        slot: Where each number that is put in goes in the buffer; its last place is for what goes nowhere.
        begin: (f + 1,) where each square begins in the buffer.
        width: (f,) unknowns: the side of each square.
        inside: (f,) how many of them are eliminated; they come first.
    """

    slot: Index
    begin: Index
    width: Index
    inside: Index

    def __len__(self) -> int:
        """Return how many squares there are."""
        return len(self.width)


@dataclass(frozen=True, slots=True)
class Layout:
    """Where everything goes, for p parts.

    Args:
        cells: Squares of the cells, from the 81 numbers of each element.
        parts: Squares of the parts, from what is left of the cells, one after the other.
        first_outline: (p + 1,) where each part's outline begins in ``dofs``.
        dofs: Unknowns of the sheet, outline after outline, each with the one held last.
    """

    cells: Fronts
    parts: Fronts
    first_outline: Index
    dofs: Index


def make_layout(part: Index, element: Index, count: int, grid: SharedMesh) -> Layout:
    """Return where the numbers of touched elements go.

    Args:
        part: (e,) which part touches the element.
        element: (e,) which element.
        count: Parts in all, p.
        grid: The mesh.
    """
    cell, owner = _cells(part, element, count, grid)
    dofs = grid.dofs[element]
    valid = dofs >= 0
    n_dofs = len(grid.sharing)
    unique, back = np.unique((cell[:, None] * n_dofs + dofs)[valid], return_inverse=True)
    of_cell, dof = np.divmod(unique, n_dofs)
    times = np.bincount(back, minlength=len(unique))
    inside = times == grid.sharing[dof]
    order, place, begin, width, n_inside = _placed(of_cell, inside, len(owner))
    local = np.full(dofs.shape, -1, dtype=np.intp)
    local[valid] = place[back]
    slot = (begin[cell, None] + local * width[cell, None])[:, :, None] + local[:, None, :]
    slot[~(valid[:, :, None] & valid[:, None, :])] = begin[-1]
    cells = Fronts(slot.ravel(), begin, width, n_inside)

    border = order[~inside[order]]
    shared = owner[of_cell[border]] * n_dofs + dof[border]
    unique, back = np.unique(shared, return_inverse=True)
    of_part, dof = np.divmod(unique, n_dofs)
    inside = np.bincount(back, times[border], minlength=len(unique)) == grid.sharing[dof]
    order, place, begin, width, n_inside = _placed(of_part, inside, count)
    left = width_of(cells)
    rows = begin[of_part[back]] + place[back] * width[of_part[back]]
    size = np.repeat(left, left)
    row_first = np.repeat(np.cumsum(left) - left, left)
    column = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size - row_first, size)
    parts = Fronts(np.repeat(rows, size) + place[back][column], begin, width, n_inside)
    outline = order[~inside[order]]
    first = np.concatenate([[0], np.cumsum(width - n_inside)])
    return Layout(cells, parts, first, dof[outline])


def width_of(fronts: Fronts) -> Index:
    """Return (f,) how many unknowns are left of each square."""
    return np.asarray(fronts.width - fronts.inside)


def _cells(part: Index, element: Index, count: int, grid: SharedMesh) -> tuple[Index, Index]:
    """Return (e,) which cell each touched element is in, and the part of every cell."""
    row, column = np.divmod(element, grid.mesh.shape[1])
    number = part
    for at in (row, column):
        low, high = np.full(count, np.iinfo(np.intp).max), np.zeros(count, dtype=np.intp)
        np.minimum.at(low, part, at)
        np.maximum.at(high, part, at + 1)
        extent = np.maximum(high - low, 1)
        steps = -(-extent // MAX_ELEMENTS_PER_SIDE)
        most = int(steps.max(initial=1))
        number = number * most + ((at - low[part]) * steps[part]) // extent[part]
    unique, cell = np.unique(number, return_inverse=True)
    owner = np.zeros(len(unique), dtype=np.intp)
    owner[cell] = part
    return cell, owner


def _placed(owner: Index, inside: Index, count: int) -> tuple[Index, Index, Index, Index, Index]:
    """Return nodes in their order, each one's place in its square, and the squares' begin, width and insides."""
    order = np.lexsort((~inside, owner))
    width = np.bincount(owner, minlength=count)
    place = np.empty(len(owner), dtype=np.intp)
    place[order] = np.arange(len(owner)) - np.repeat(np.cumsum(width) - width, width)
    begin = np.concatenate([[0], np.cumsum(width**2)])
    return order, place, begin, width, np.bincount(owner[inside], minlength=count)
