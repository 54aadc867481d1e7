"""Touches one by one: what each adds to the sheet, condensed to a small factor, from which sets are put together.

A part is a touch, or several that share elements of the mesh. On the nodes of its outline it adds dS = F F^T to the
sheet's stiffness (its inside eliminated, touched less untouched; dS is positive, see :mod:`eitskin_sim.kinks`). With G
the inverse of the untouched sheet and E the electrodes, what a part does alone is

    L = F X^-T,   X X^T = 1 + F^T G F,   W = L^T G_oE:      U = G_EE - W^T W

and sets of parts need the products L_p^T G L_q of pairs besides (:mod:`eitskin_sim.free`). The geometry of parts
(:mod:`eitskin_sim.kinks`, :mod:`eitskin_sim.free_layout`) serves every deformation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import blas, lapack

from eitskin_proto.table import N_ELECTRODES
from eitskin_sim.free_layout import Layout, make_layout
from eitskin_sim.free_mesh import FreeMesh, with_contacts, without_middle
from eitskin_sim.free_sheet import FreeSheet, touched_blocks
from eitskin_sim.free_touches import Array, FreeTouches
from eitskin_sim.kinks import Cuts, find_cuts
from eitskin_sim.mesh import Index

BATCH: Final = 32
"""Parts whose geometry is held together: 1 MB."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """A batch of parts on the mesh, before any deformation."""

    cuts: Cuts
    layout: Layout

    def __len__(self) -> int:
        """Return how many parts there are."""
        return len(self.layout.inside)


@dataclass(frozen=True, slots=True)
class Part:
    """What a part does at one deformation: m unknowns on its outline, rank r."""

    dofs: Index
    """(m,)"""
    factor: Array
    """(m, r) L"""
    load: Array
    """(r, 16) W"""


def geometry(parts: FreeTouches, grid: FreeMesh) -> list[Geometry]:
    """Return what parts do to a mesh's elements, in batches."""
    found = []
    for start in range(0, len(parts), BATCH):
        which = np.arange(start, min(start + BATCH, len(parts)))
        cuts = find_cuts(parts, which, grid.mesh)
        found.append(Geometry(cuts, make_layout(cuts.of_set, cuts.element, len(which), grid)))
    return found


def reached(batches: Sequence[Geometry], n_elements: int) -> npt.NDArray[np.uint64]:
    """Return (p, w) which elements each part touches, as bits."""
    rows = []
    for batch in batches:
        bits = np.zeros((len(batch), -(-n_elements // 64) * 64), dtype=np.bool_)
        bits[batch.cuts.of_set, batch.cuts.element] = True
        rows.append(np.packbits(bits, axis=1).view(np.uint64))
    return np.concatenate(rows) if rows else np.zeros((0, 1), dtype=np.uint64)


def condense(sheet: FreeSheet, batches: Sequence[Geometry]) -> list[Part]:
    """Return parts at one deformation."""
    return [part for batch in batches for part in _condensed(sheet, batch)]


def _condensed(sheet: FreeSheet, batch: Geometry) -> list[Part]:
    cuts, layout = batch.cuts, batch.layout
    blocks, density = touched_blocks(sheet, cuts)
    after = without_middle(with_contacts(blocks, cuts.element, density, sheet.system.contacts))
    size = int(layout.begin[-1]) + 1
    before = sheet.before[cuts.element]
    touched, untouched = (
        np.bincount(layout.slot, blocks.ravel(), minlength=size).astype(np.float64, copy=False)
        for blocks in (after, before)
    )
    found = []
    for number in range(len(batch)):
        own, width = slice(layout.begin[number], layout.begin[number + 1]), layout.width[number]
        dofs = layout.dofs[layout.first_outline[number] : layout.first_outline[number + 1]]
        square, without = touched[own].reshape(width, width), untouched[own].reshape(width, width)
        found.append(_part(sheet, dofs, _change(square, without, int(layout.inside[number]))))
    return found


def _change(touched: Array, untouched: Array, inside: int) -> Array:
    """Return dS on the outline, its lower half alone, (m - 1, m - 1), from two (i + m - 1, i + m - 1), which are lost.

    A factor's last triangle is the factor of what is left once all before it is eliminated.
    """
    if not inside:
        return np.asarray((touched - untouched).T)
    change: Array | None = None
    for whole, sign in ((touched, 1.0), (untouched, -1.0)):
        triangle, _ = lapack.dpotrf(whole.T, lower=1, clean=0, overwrite_a=1)
        left = lower_half(triangle[inside:, inside:])
        kept = {} if change is None else {"beta": 1.0, "c": change, "overwrite_c": 1}
        change = blas.dsyrk(sign, left, lower=1, **kept)
    return np.asarray(change)


def lower_half(square: Array) -> Array:
    """Return a matrix with zeros above its diagonal, five times as fast as numpy's tril."""
    rows, columns = square.shape
    if rows > len(_LOWER):
        return np.tril(square)
    return np.asarray(square * _LOWER[:rows, :columns])


_LOWER: Final[Array] = np.asfortranarray(np.tri(512))


def _part(sheet: FreeSheet, dofs: Index, change: Array) -> Part:
    if len(dofs) < 2:
        return Part(dofs, np.empty((len(dofs), 0)), np.empty((0, N_ELECTRODES)))
    triangle, pivot, rank, _ = lapack.dpstrf(change, lower=1, overwrite_a=1)
    bare = np.empty((len(dofs), rank), order="F")
    bare[pivot - 1] = lower_half(triangle[:, :rank])
    bare[-1] = -bare[:-1].sum(axis=0)  # a constant potential passes no current
    own = bare.T @ (between(sheet.inverse, dofs, dofs) @ bare)
    own[np.diag_indices(rank)] += 1.0
    root, _ = lapack.dpotrf(own.T, lower=1, overwrite_a=1, clean=0)
    factor = blas.dtrsm(1.0, root, bare, side=1, lower=1, trans_a=1, overwrite_b=1)  # from the right: thrice as fast
    return Part(dofs, np.ascontiguousarray(factor), factor.T @ sheet.inverse[dofs, -N_ELECTRODES:])


def between(inverse: Array, rows: Index, columns: Index) -> Array:
    """Return (m, n) entries of the dense inverse, twice as fast as by numpy's indexing."""
    return inverse.reshape(-1).take(rows[:, None] * len(inverse) + columns, mode="wrap")
