"""Condenses each touch's contribution to the sheet to a small factor; sets of touches are assembled from these.

A part is a touch, or several that share elements of the mesh. On the nodes of its outline it adds dS = F J F^T to the
sheet's stiffness (its inside eliminated, touched less untouched). J is 1 where touches conduct better than the sheet,
since dS is then positive (:mod:`eitskin_sim.fem.borders.cut_touches`), and -1 where they conduct worse; a part of both
kinds has columns of either sign, those of 1 first. With G the inverse of the untouched sheet and E the electrodes, what
a part does alone is

    L = F X^-T,   X J X^T = J + F^T G F,   W = L^T G_oE:      U = G_EE - W^T J W

X is triangular, block by block: the sheet stays a conductor after each. Sets of parts also need the products L_p^T G
L_q of pairs (:mod:`eitskin_sim.freeform.voltages`). The geometry of parts (:mod:`eitskin_sim.fem.borders.cut_touches`,
:mod:`eitskin_sim.freeform.layout`) serves every deformation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import blas, lapack

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.borders.cut_touches import Cuts, check_pieces, find_cuts
from eitskin_sim.freeform.layout import Fronts, Layout, make_layout
from eitskin_sim.freeform.mesh import SharedMesh, with_contacts, without_middle
from eitskin_sim.freeform.sheet import InvertedSheet, touched_blocks
from eitskin_sim.scene.touch_table import TouchTable, gather

PARTS_PER_BATCH: Final = 32
"""Parts whose geometry is held together: 1 MB."""


@dataclass(frozen=True, slots=True)
class PartGeometry:
    """A batch of parts on the mesh, before any deformation."""

    cuts: Cuts
    layout: Layout
    signs: npt.NDArray[np.int8]
    """(p,) 1 where all of a part conducts better than the sheet, -1 where all conducts worse, 0 where some does."""

    def __len__(self) -> int:
        """Return how many parts there are."""
        return len(self.layout.parts)


@dataclass(frozen=True, slots=True)
class CondensedPart:
    """The effect of a part at one deformation: m unknowns on its outline, rank r."""

    dofs: Index
    """(m,)"""
    factor: Array
    """(m, r) L"""
    load: Array
    """(r, 16) W"""
    positive: int
    """How many columns conduct better than the sheet; they come first."""


def geometry(parts: TouchTable, grid: SharedMesh) -> list[PartGeometry]:
    """Return the effect of parts on a mesh's elements, in batches.

    Raises:
        ValueError: A touch would change nothing, or its border cannot be represented.
    """
    check_pieces(parts.pieces, grid.mesh)
    found = []
    for start in range(0, len(parts), PARTS_PER_BATCH):
        which = np.arange(start, min(start + PARTS_PER_BATCH, len(parts)))
        cuts = find_cuts(parts, which, grid.mesh)
        layout = make_layout(cuts.of_set, cuts.element, len(which), grid)
        found.append(PartGeometry(cuts, layout, signs_of(parts.chosen(which))))
    return found


def joined_geometry(parts: TouchTable, groups: Sequence[tuple[int, ...]], grid: SharedMesh) -> list[PartGeometry]:
    """Return the effect of groups of parts, each one part, on a mesh's elements, in batches.

    Args:
        parts: The parts that groups are made of.
        groups: Numbers of parts.
        grid: The mesh.
    """
    if not groups:
        return []
    return geometry(gather([np.concatenate([parts.of(part) for part in group]) for group in groups]), grid)


def signs_of(touches: TouchTable) -> npt.NDArray[np.int8]:
    """Return (s,) 1 for touch sets that conduct better than the sheet, -1 for worse, 0 for some of each."""
    better = touches.pieces[:, 6] > 1.0
    owner = np.repeat(np.arange(len(touches)), np.diff(touches.first))
    found = (np.bincount(owner, better, len(touches)) > 0).astype(np.int8)
    found -= np.bincount(owner, ~better, len(touches)) > 0
    return np.where(np.diff(touches.first) == 0, np.int8(1), found)


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
        change = _change(square, without, int(layout.parts.inside[number]))
        found.append(_part(sheet, dofs, change, int(batch.signs[number])))
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


DIAGONAL_LIFT: Final = 1e-14
"""Term added to the diagonal of dS, as a share of its largest: thin cuts leave eigenvalues of zero."""


def _part(sheet: InvertedSheet, dofs: Index, change: Array, sign: int) -> CondensedPart:
    if len(dofs) < 2:
        return CondensedPart(dofs, np.empty((len(dofs), 0)), np.empty((0, N_ELECTRODES)), 0)
    seen = between(sheet.inverse, dofs, dofs)
    if sign == 0:
        factor, positive = _mixed(change, seen)
        return CondensedPart(dofs, factor, factor.T @ sheet.to_terminals[dofs], positive)
    bare = _root(change) if sign > 0 else _root(-change)
    own = bare.T @ (seen @ bare)
    if sign < 0:
        own *= -1.0
    factor = _alone(own, bare)
    positive = factor.shape[1] if sign > 0 else 0
    return CondensedPart(dofs, np.ascontiguousarray(factor), factor.T @ sheet.to_terminals[dofs], positive)


def _alone(own: Array, bare: Array) -> Array:
    """Return F X^-T with X X^T = 1 + ``own``; both arguments are overwritten."""
    own.reshape(-1)[:: len(own) + 1] += 1.0
    root, failed = lapack.dpotrf(own.T, lower=1, overwrite_a=1, clean=0)
    if failed:
        raise ValueError(
            "a touch takes away more conductance than its place on the sheet has; expected a contrast well above 0"
        )
    return np.asarray(blas.dtrsm(1.0, root, bare, side=1, lower=1, trans_a=1, overwrite_b=1))  # right: thrice as fast


ZERO_EIGENVALUE: Final = 1e-14
"""Relative size under which an eigenvalue of a dS of both signs is none."""


def _mixed(change: Array, seen: Array) -> tuple[Array, int]:
    """Return L of a dS of both signs, from its lower half and the inverse at the outline, and its columns of 1."""
    value, vector = np.linalg.eigh(change)
    least = ZERO_EIGENVALUE * np.abs(value).max()
    roots = []
    for which, size in ((value > least, value), (value < -least, -value)):
        bare = np.zeros((len(change) + 1, np.count_nonzero(which)), order="F")
        bare[:-1] = vector[:, which] * np.sqrt(size[which])
        bare[-1] = -bare.sum(axis=0)  # a constant potential passes no current
        roots.append(bare)
    better, worse = roots
    better = _alone(np.ascontiguousarray(better.T @ (seen @ better)), better)
    across = worse.T @ (seen @ better)
    own = across @ across.T - worse.T @ (seen @ worse)
    worse = _alone(own, np.asfortranarray(worse - better @ across.T))
    return np.concatenate([better, worse], axis=1), better.shape[1]


def _root(change: Array) -> Array:
    """Return (m, r) F with F F^T = dS, the unknown held included, from the lower half of (m - 1, m - 1) dS.

    Pivots find the rank of a dS that is nearly none, but take four times as long.
    """
    rank = len(change)
    lifted = change.copy(order="F")
    lifted.T.reshape(-1)[:: rank + 1] += DIAGONAL_LIFT * change.diagonal().max()
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
