"""Which unknowns a batch of touch sets changes, and where every number goes: made once, used at every deformation.

Touched elements of a set that share nodes form a patch. A patch's nodes are inside, when all their elements are
touched, or
on its outline. Patches follow each other set by set; each is a square of numbers in one long buffer. ::

    elements --81 numbers each--> patches (inside | outline) --eliminate the inside--> outlines --> sets
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from eitskin_sim.free_mesh import FreeMesh
from eitskin_sim.mesh import Index

SLICE: Final = 40
"""Elements of a patch: more of them cost more to eliminate, more patches share more nodes."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where everything goes, for p patches of s sets.

    Args:
        slot: (e * 81,) where each number of the elements' blocks goes in the buffer; its last place is for what goes
            nowhere.
        begin: (p + 1,) where each patch begins in the buffer.
        inside: (p,) unknowns inside.
        outline: (p,) unknowns on the outline, which follow them.
        first_outline: (p + 1,) where each patch's outline begins in ``dofs``.
        dofs: Unknowns of the sheet, outline after outline.
        first_patch: (s + 1,) where each set's patches begin.
    """

    slot: Index
    begin: Index
    inside: Index
    outline: Index
    first_outline: Index
    dofs: Index
    first_patch: Index


def make_layout(of_set: Index, element: Index, count: int, grid: FreeMesh) -> Layout:
    """Return where the numbers of touched elements go.

    Args:
        of_set: (e,) which set touches the element.
        element: (e,) which element.
        count: Sets in all, s.
        grid: The mesh.
    """
    dofs = grid.dofs[element]
    valid = dofs >= 0
    n_dofs = len(grid.sharing)
    own = _patches(of_set, element, dofs, grid)
    key = own[:, None] * n_dofs + np.maximum(dofs, 0)
    unique, back = np.unique(key[valid], return_inverse=True)
    patch = unique // n_dofs
    inside = np.bincount(back, minlength=len(unique)) == grid.sharing[unique % n_dofs]

    order = np.lexsort((unique, ~inside, patch))
    n_patches = int(patch.max(initial=-1)) + 1
    n_inside = np.bincount(patch[inside], minlength=n_patches)
    n_outline = np.bincount(patch[~inside], minlength=n_patches)
    width = n_inside + n_outline
    place = np.empty(len(unique), dtype=np.intp)
    place[order] = np.arange(len(unique)) - np.repeat(np.cumsum(width) - width, width)

    begin = np.concatenate([[0], np.cumsum(width**2)])
    local = np.full(dofs.shape, -1, dtype=np.intp)
    local[valid] = place[back]
    slot = begin[own, None, None] + local[:, :, None] * width[own, None, None] + local[:, None, :]
    slot[~(valid[:, :, None] & valid[:, None, :])] = begin[-1]

    set_of_patch = np.zeros(n_patches, dtype=np.intp)
    set_of_patch[own] = of_set
    return Layout(
        slot=slot.ravel(),
        begin=begin,
        inside=n_inside,
        outline=n_outline,
        first_outline=np.concatenate([[0], np.cumsum(n_outline)]),
        dofs=unique[order[~inside[order]]] % n_dofs,
        first_patch=np.searchsorted(set_of_patch, np.arange(count + 1)),
    )


def _patches(of_set: Index, element: Index, dofs: Index, grid: FreeMesh) -> Index:
    """Return the (e,) patch of each touched element; patches of one set follow each other.

    A patch is what hangs together, cut across its longer side into slices of about ``SLICE`` elements.
    """
    n_dofs, count = len(grid.sharing), len(element)
    row, column = np.nonzero(dofs >= 0)
    unique, node = np.unique(of_set[row] * n_dofs + dofs[row, column], return_inverse=True)
    size = count + len(unique)
    graph = coo_array((np.ones(len(row), dtype=np.int8), (row, count + node)), (size, size))
    together = connected_components(graph, directed=False)[1][:count]
    together = np.unique(together, return_inverse=True)[1].astype(np.intp)
    elements = np.bincount(together)
    place = np.divmod(element, grid.mesh.shape[1])
    low = [np.full(len(elements), count + grid.mesh.n_elements) for _ in place]
    high = [np.zeros(len(elements), dtype=np.intp) for _ in place]
    for axis, at in enumerate(place):
        np.minimum.at(low[axis], together, at)
        np.maximum.at(high[axis], together, at)
    upright = (high[0] - low[0] > high[1] - low[1])[together]
    along = np.where(upright, place[0] - low[0][together], place[1] - low[1][together])
    extent = np.where(upright, (high[0] - low[0])[together], (high[1] - low[1])[together]) + 1
    slices = np.maximum(1, np.rint(elements / SLICE)).astype(np.intp)[together]
    key = (of_set * len(elements) + together) * int(slices.max(initial=1)) + along * slices // extent
    return np.asarray(np.unique(key, return_inverse=True)[1])
