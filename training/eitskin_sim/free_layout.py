"""Which unknowns the touched elements of a part have, and where every number goes: made once for all deformations.

A part is a touch, or several that share elements. Its nodes are inside, when all their elements are touched, or on its
outline. The last of an outline is held at zero: a part passes no current where all potentials are alike, so what it
does to the others says all. Parts follow each other, each a square of numbers in one long buffer. ::

    elements --81 numbers each--> parts (inside | outline) --eliminate the inside--> outlines
"""

from dataclasses import dataclass

import numpy as np

from eitskin_sim.free_mesh import FreeMesh
from eitskin_sim.mesh import Index


@dataclass(frozen=True, slots=True)
class Layout:
    """Where everything goes, for p parts.

    Args:
        slot: (e * 81,) where each number of the elements' blocks goes in the buffer; its last place is for what goes
            nowhere.
        begin: (p + 1,) where each part begins in the buffer.
        width: (p,) unknowns of each part but the one held: the side of its square.
        inside: (p,) how many of them are inside; they come first.
        first_outline: (p + 1,) where each part's outline begins in ``dofs``.
        dofs: Unknowns of the sheet, outline after outline, each with the one held last.
    """

    slot: Index
    begin: Index
    width: Index
    inside: Index
    first_outline: Index
    dofs: Index


def make_layout(part: Index, element: Index, count: int, grid: FreeMesh) -> Layout:
    """Return where the numbers of touched elements go.

    Args:
        part: (e,) which part touches the element.
        element: (e,) which element.
        count: Parts in all, p.
        grid: The mesh.
    """
    dofs = grid.dofs[element]
    valid = dofs >= 0
    n_dofs = len(grid.sharing)
    key = part[:, None] * n_dofs + np.maximum(dofs, 0)
    unique, back = np.unique(key[valid], return_inverse=True)
    owner = unique // n_dofs
    inside = np.bincount(back, minlength=len(unique)) == grid.sharing[unique % n_dofs]

    order = np.lexsort((unique, ~inside, owner))
    n_inside = np.bincount(owner[inside], minlength=count)
    n_outline = np.bincount(owner[~inside], minlength=count)
    total = n_inside + n_outline
    place = np.empty(len(unique), dtype=np.intp)
    place[order] = np.arange(len(unique)) - np.repeat(np.cumsum(total) - total, total)

    width = np.maximum(total - 1, 0)
    place[place == width[owner]] = -1
    begin = np.concatenate([[0], np.cumsum(width**2)])
    local = np.full(dofs.shape, -1, dtype=np.intp)
    local[valid] = place[back]
    slot = begin[part, None, None] + local[:, :, None] * width[part, None, None] + local[:, None, :]
    kept = local >= 0
    slot[~(kept[:, :, None] & kept[:, None, :])] = begin[-1]
    return Layout(
        slot=slot.ravel(),
        begin=begin,
        width=width,
        inside=n_inside,
        first_outline=np.concatenate([[0], np.cumsum(n_outline)]),
        dofs=unique[order[~inside[order]]] % n_dofs,
    )
