"""Touches one by one: what each adds to the sheet, condensed to a small factor, from which sets are put together.

A part is a touch, or several that share elements of the mesh. On the nodes of its outline it adds dS = F F^T to the
sheet's stiffness (its inside eliminated, touched less untouched; dS is positive, see
:mod:`eitskin_sim.fem.cut_touches`). With G the inverse of the untouched sheet and E the electrodes, what a part does
alone is

    L = F X^-T,   X X^T = 1 + F^T G F,   W = L^T G_oE:      U = G_EE - W^T W

and sets of parts need the products L_p^T G L_q of pairs besides (:mod:`eitskin_sim.freeform.voltages`). The geometry of
parts (:mod:`eitskin_sim.fem.cut_touches`, :mod:`eitskin_sim.freeform.layout`) serves every deformation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import blas, lapack

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.fem.cut_touches import Cuts, find_cuts
from eitskin_sim.fem.mesh import Index
from eitskin_sim.freeform.layout import Fronts, Layout, make_layout
from eitskin_sim.freeform.mesh import SharedMesh, with_contacts, without_middle
from eitskin_sim.freeform.sheet import InvertedSheet, touched_blocks
from eitskin_sim.scene.touch_table import Array, TouchTable

BATCH: Final = 32
"""Parts whose geometry is held together: 1 MB."""


@dataclass(frozen=True, slots=True)
class PartGeometry:
    """A batch of parts on the mesh, before any deformation."""

    cuts: Cuts
    layout: Layout

    def __len__(self) -> int:
        """Return how many parts there are."""
        return len(self.layout.parts)


@dataclass(frozen=True, slots=True)
class CondensedPart:
    """What a part does at one deformation: m unknowns on its outline, rank r."""

    dofs: Index
    """(m,)"""
    factor: Array
    """(m, r) L"""
    load: Array
    """(r, 16) W"""


def geometry(parts: TouchTable, grid: SharedMesh) -> list[PartGeometry]:
    """Return what parts do to a mesh's elements, in batches."""
    found = []
    for start in range(0, len(parts), BATCH):
        which = np.arange(start, min(start + BATCH, len(parts)))
        cuts = find_cuts(parts, which, grid.mesh)
        found.append(PartGeometry(cuts, make_layout(cuts.of_set, cuts.element, len(which), grid)))
    return found


def reached(batches: Sequence[PartGeometry], n_elements: int) -> npt.NDArray[np.uint64]:
    """Return (p, w) which elements each part touches, as bits."""
    rows = []
    for batch in batches:
        bits = np.zeros((len(batch), -(-n_elements // 64) * 64), dtype=np.bool_)
        bits[batch.cuts.of_set, batch.cuts.element] = True
        rows.append(np.packbits(bits, axis=1).view(np.uint64))
    return np.concatenate(rows) if rows else np.zeros((0, 1), dtype=np.uint64)


def condense(sheet: InvertedSheet, batches: Sequence[PartGeometry]) -> list[CondensedPart]:
    """Return parts at one deformation."""
    return [part for batch in batches for part in _condensed(sheet, batch)]


def _condensed(sheet: InvertedSheet, batch: PartGeometry) -> list[CondensedPart]:
    cuts, layout = batch.cuts, batch.layout
    blocks, density = touched_blocks(sheet, cuts)
    after = without_middle(with_contacts(blocks, cuts.element, density, sheet.system.contacts))
    touched, untouched = (_cells_left(layout, numbers) for numbers in (after, sheet.before[cuts.element]))
    found = []
    for number, (square, without) in enumerate(zip(touched, untouched, strict=True)):
        dofs = layout.dofs[layout.first_outline[number] : layout.first_outline[number + 1]]
        found.append(_part(sheet, dofs, _change(square, without, int(layout.parts.inside[number]))))
    return found


def _cells_left(layout: Layout, blocks: Array) -> list[Array]:
    """Return the squares of the parts, from the (e, 9, 9) blocks of their elements: insides of cells eliminated."""
    cells = layout.cells
    left = np.empty(len(layout.parts.slot))
    start = 0
    for square, inside in zip(_squares(cells, blocks.ravel()), cells.inside.tolist(), strict=True):
        size = len(square) - inside
        own = left[start : start + size * size].reshape(size, size)
        start += size * size
        own[...] = square[inside:, inside:]
        if inside:
            panel = _panel(square, inside, len(square))
            blas.dgemm(-1.0, panel, panel, beta=1.0, c=own.T, trans_b=1, overwrite_c=1)
    return _squares(layout.parts, left)


def _squares(fronts: Fronts, numbers: Array) -> list[Array]:
    """Return squares into which numbers are added up."""
    buffer: Array = np.bincount(fronts.slot, numbers, int(fronts.begin[-1]) + 1).astype(np.float64, copy=False)
    places = zip(fronts.begin[:-1].tolist(), fronts.begin[1:].tolist(), fronts.width.tolist(), strict=True)
    return [buffer[start:stop].reshape(width, width) for start, stop, width in places]


def _panel(square: Array, inside: int, stop: int) -> Array:
    """Return (stop - inside, inside) P: eliminating what is inside takes P P^T from what is left."""
    upright = square.T  # the same, but LAPACK need not turn it
    root, _ = lapack.dpotrf(upright[:inside, :inside], lower=1, clean=0)
    return np.asarray(blas.dtrsm(1.0, root, upright[inside:stop, :inside], side=1, lower=1, trans_a=1))


def _change(touched: Array, untouched: Array, inside: int) -> Array:
    """Return dS on the outline but the one held, its lower half alone, (m - 1, m - 1), from two (i + m, i + m)."""
    own = slice(inside, -1)
    change = np.asarray((touched[own, own] - untouched[own, own]).T)
    if inside:
        for square, sign in ((touched, -1.0), (untouched, 1.0)):
            panel = _panel(square, inside, len(square) - 1)
            change = blas.dsyrk(sign, panel, beta=1.0, c=change, lower=1, overwrite_c=1)
    return change


LIFT: Final = 1e-14
"""What is added to the diagonal of dS, as a share of its largest: thin cuts leave eigenvalues of zero."""


def _part(sheet: InvertedSheet, dofs: Index, change: Array) -> CondensedPart:
    if len(dofs) < 2:
        return CondensedPart(dofs, np.empty((len(dofs), 0)), np.empty((0, N_ELECTRODES)))
    bare = _root(change)
    own = bare.T @ (between(sheet.inverse, dofs, dofs) @ bare)
    own.reshape(-1)[:: len(own) + 1] += 1.0
    root, _ = lapack.dpotrf(own.T, lower=1, overwrite_a=1, clean=0)
    factor = blas.dtrsm(1.0, root, bare, side=1, lower=1, trans_a=1, overwrite_b=1)  # from the right: thrice as fast
    return CondensedPart(dofs, np.ascontiguousarray(factor), factor.T @ sheet.to_terminals[dofs])


def _root(change: Array) -> Array:
    """Return (m, r) F with F F^T = dS, the unknown held included, from the lower half of (m - 1, m - 1) dS.

    Pivots find the rank of a dS that is nearly none, but take four times as long.
    """
    rank = len(change)
    lifted = change.copy(order="F")
    lifted.T.reshape(-1)[:: rank + 1] += LIFT * change.diagonal().max()
    triangle, failed = lapack.dpotrf(lifted, lower=1, overwrite_a=1, clean=0)
    row: Index | slice = slice(rank)
    if failed:
        triangle, pivot, rank, _ = lapack.dpstrf(change, lower=1)
        row = pivot - 1
    bare = np.zeros((len(change) + 1, rank), order="F")
    bare[row] = lower_half(triangle[:, :rank])
    bare[-1] = -bare.sum(axis=0)  # a constant potential passes no current
    return bare


def lower_half(square: Array) -> Array:
    """Return a matrix with zeros above its diagonal, five times as fast as numpy's tril."""
    rows, columns = square.shape
    if rows > len(_LOWER):
        return np.tril(square)
    return np.asarray(square * _LOWER[:rows, :columns])


_LOWER: Final[Array] = np.asfortranarray(np.tri(512))


def between(inverse: Array, rows: Index, columns: Index) -> Array:
    """Return (m, n) entries of the dense inverse, twice as fast as by numpy's indexing."""
    return inverse.reshape(-1).take(rows[:, None] * len(inverse) + columns, mode="wrap")
