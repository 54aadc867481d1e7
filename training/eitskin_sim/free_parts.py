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
from scipy.linalg import lapack

from eitskin_proto.table import N_ELECTRODES
from eitskin_sim.free_layout import Layout, make_layout
from eitskin_sim.free_mesh import FreeMesh, with_contacts, without_middle
from eitskin_sim.free_sheet import FreeSheet, touched_blocks
from eitskin_sim.free_touches import Array, FreeTouches
from eitskin_sim.kinks import Cuts, find_cuts
from eitskin_sim.mesh import Index

BATCH: Final = 128
"""Parts whose geometry is held together: 5 MB."""


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
        inside = int(layout.inside[number])
        width = inside + int(layout.outline[number])
        own = slice(layout.begin[number], layout.begin[number + 1])
        change = _outlined(touched[own].reshape(width, width), inside)
        change -= _outlined(untouched[own].reshape(width, width), inside)
        dofs = layout.dofs[layout.first_outline[number] : layout.first_outline[number + 1]]
        found.append(_part(sheet, dofs, change))
    return found


def _outlined(whole: Array, inside: int) -> Array:
    """Return the (m - 1, m - 1) stiffness of a part on its outline, the last node held.

    A factor's last triangle is the factor of what is left once all before it is eliminated.
    """
    if not inside or not len(whole):
        return whole[:-1, :-1].copy()
    triangle, _ = lapack.dpotrf(whole[:-1, :-1].T, lower=1, clean=0)
    left = np.tril(triangle[inside:, inside:])
    return np.asarray(left @ left.T)


def _part(sheet: FreeSheet, dofs: Index, change: Array) -> Part:
    if not len(dofs):
        return Part(dofs, np.empty((0, 0)), np.empty((0, N_ELECTRODES)))
    triangle, pivot, rank, _ = lapack.dpstrf(change, lower=1)
    order = pivot - 1
    bare = np.empty((len(dofs), rank))
    bare[order] = np.tril(triangle[:, :rank])
    bare[-1] = -bare[:-1].sum(axis=0)  # a constant potential passes no current
    green = sheet.inverse[dofs[:, None], dofs]
    own = bare.T @ green @ bare
    own[np.diag_indices(rank)] += 1.0
    root, _ = lapack.dpotrf(own, lower=1)
    factor, _ = lapack.dtrtrs(root, bare.T, lower=1)
    load = factor @ sheet.inverse[dofs, -N_ELECTRODES:]
    return Part(dofs, np.ascontiguousarray(factor.T), load)
