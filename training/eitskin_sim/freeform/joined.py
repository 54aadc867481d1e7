"""Geometry of touches that share elements: where one of them alone reaches an element, that is known already.

Of a part that is several touches, most elements are reached by one touch only. What becomes of those was integrated
with the touch itself; the elements that they share are integrated for both together.
"""

from collections.abc import Sequence

import numpy as np

from eitskin_sim.fem.borders.cut_blocks import Integrals
from eitskin_sim.fem.borders.cut_touches import Cuts, find_cuts
from eitskin_sim.fem.borders.graded_blocks import GradedIntegrals
from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.freeform.layout import make_layout
from eitskin_sim.freeform.mesh import SharedMesh
from eitskin_sim.freeform.parts import BATCH, PartGeometry, signs_of
from eitskin_sim.scene.touch_table import TouchTable, gather

Taken = tuple[Cuts, Index, Index]
"""Cuts of a batch of parts, which of their rows are taken, and the new part of each."""


def joined_geometry(
    parts: TouchTable, batches: Sequence[PartGeometry], groups: Sequence[tuple[int, ...]], grid: SharedMesh
) -> list[PartGeometry]:
    """Return what groups of parts, each one part, do to a mesh's elements, in batches.

    Args:
        parts: The parts that groups are made of.
        batches: Their geometry, in their order.
        groups: Numbers of parts.
        grid: The mesh.
    """
    first = np.concatenate([[0], np.cumsum([len(batch) for batch in batches])])
    rows = [_rows_of_parts(batch) for batch in batches]
    found = []
    for start in range(0, len(groups), BATCH):
        some = groups[start : start + BATCH]
        table = gather([np.concatenate([parts.of(part) for part in group]) for group in some])
        member = np.concatenate([np.array(group) for group in some])
        owner = np.repeat(np.arange(len(some)), [len(group) for group in some])
        sources: list[Taken] = []
        for number in np.unique(np.searchsorted(first, member, side="right") - 1).tolist():
            own = np.flatnonzero((member >= first[number]) & (member < first[number + 1]))
            taken = [rows[number][part] for part in (member[own] - first[number]).tolist()]
            into = np.repeat(owner[own], [len(one) for one in taken])
            sources.append((batches[number].cuts, np.concatenate(taken), into))
        cuts = _joined(table, sources, grid)
        layout = make_layout(cuts.of_set, cuts.element, len(some), grid)
        found.append(PartGeometry(cuts, layout, signs_of(table)))
    return found


def _rows_of_parts(batch: PartGeometry) -> list[Index]:
    """Return the rows of each part of a batch in its cuts."""
    order = np.argsort(batch.cuts.of_set, kind="stable")
    ends = np.cumsum(np.bincount(batch.cuts.of_set, minlength=len(batch)))
    return np.split(order, ends[:-1])


def _joined(table: TouchTable, sources: Sequence[Taken], grid: SharedMesh) -> Cuts:
    """Return the cuts of new parts, from those of the parts that they are made of."""
    n_elements = grid.mesh.n_elements
    keys = [into * n_elements + cuts.element[rows] for cuts, rows, into in sources]
    unique, back, times = np.unique(np.concatenate(keys), return_inverse=True, return_counts=True)
    alone = np.split(times[back] == 1, np.cumsum([len(key) for key in keys])[:-1])
    shared = np.zeros((len(table), n_elements), dtype=np.bool_)
    shared.reshape(-1)[unique[times > 1]] = True
    fresh = find_cuts(table, np.arange(len(table)), grid.mesh, among=shared)
    everything = (fresh, np.arange(len(fresh.element)), fresh.of_set)
    kept = [(cuts, rows[own], into[own]) for (cuts, rows, into), own in zip(sources, alone, strict=True)]
    cut, graded, whole = ([_within(one, which) for one in (*kept, everything)] for which in range(3))
    ordered = [*cut, *graded, *whole]

    def column(name: str) -> Array:
        return np.concatenate([getattr(cuts, name)[rows] for cuts, rows, _ in ordered])

    return Cuts(
        of_set=np.concatenate([into for *_, into in ordered]),
        element=column("element").astype(np.intp),
        sigma=column("sigma"),
        share=column("share"),
        integrals=_integrals(cut),
        graded=_graded(graded),
    )


def _within(taken: Taken, which: int) -> Taken:
    """Return what is taken of the elements that are cut (0), that a graded border reaches (1), or that lie within."""
    cuts, rows, into = taken
    ends = (0, cuts.n_cut, cuts.n_cut + cuts.n_graded, len(cuts.element))
    own = (rows >= ends[which]) & (rows < ends[which + 1])
    return cuts, rows[own], into[own]


def _integrals(taken: Sequence[Taken]) -> Integrals:
    def column(name: str) -> Array:
        return np.concatenate([getattr(cuts.integrals, name)[rows] for cuts, rows, _ in taken])

    return Integrals(column("added"), column("held"), column("coupling"), column("corner"), column("centroid"))


def _graded(taken: Sequence[Taken]) -> GradedIntegrals | None:
    known = [(cuts.graded, rows - cuts.n_cut) for cuts, rows, _ in taken if cuts.graded is not None]
    if not known:
        return None

    def column(name: str, axis: int = 0) -> Array:
        return np.concatenate([np.take(getattr(graded, name), rows, axis) for graded, rows in known], axis)

    return GradedIntegrals(
        column("added"), column("coupling", 1), column("corner", 1), column("centroid"), column("sigma")
    )
