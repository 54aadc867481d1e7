"""The blocks of the elements that touches cover or cut, and how they change with every parameter of every touch.

Blocks are those of the generators (:mod:`eitskin_sim.freeform.sheet`), by the one rule for cut elements; where touches
overlap an element is covered once. A rate is a difference quotient of a touch's own few elements, all moves at once
(:mod:`eitskin_sim.shapes.ways`): no system is solved for it, and whatever the rule is, these are its own derivatives.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.fem.borders.cut_touches import Cuts, find_cuts
from eitskin_sim.fem.mesh import Index
from eitskin_sim.freeform.mesh import with_contacts, without_middle
from eitskin_sim.freeform.sheet import AssembledSheet, touched_blocks
from eitskin_sim.scene.touch_table import Array, TouchTable
from eitskin_sim.shapes.parameters import COUNT
from eitskin_sim.shapes.ways import ways_of

BLOCK: Final = 9
"""Unknowns of an element: its eight outer nodes and the electrode over it."""


@dataclass(frozen=True, slots=True)
class Blocks:
    """Elements of touch sets, e in all."""

    of_set: Index
    """(e,)"""
    element: Index
    """(e,)"""
    blocks: Array
    """(e, 9, 9) S, without the middle nodes."""


@dataclass(frozen=True, slots=True)
class Rates:
    """How blocks change with c moves of touches, of which r parameters are made."""

    mix: Array
    """(c, r)"""
    element: Index
    """(q,) elements, move after move."""
    first: Index
    """(c + 1,) where those of each begin."""
    blocks: Array
    """(q, 9, 9) S by mm, rad, or 1."""


def touched(sheet: AssembledSheet, sets: list[Array], among: npt.NDArray[np.bool_] | None = None) -> Blocks:
    """Return what touch sets, (n, 8) pieces each, make of a sheet's elements, sorted by set and element.

    Args:
        sheet: The deformation.
        sets: (n, 8) pieces each.
        among: (sets, n_elements) the elements that are looked at; None for all.

    Raises:
        ValueError: A border cannot be represented, or a piece would change nothing.
    """
    first = np.concatenate([[0], np.cumsum([len(one) for one in sets])]).astype(np.int64)
    table = TouchTable(np.concatenate(sets), first)
    cuts = find_cuts(table, np.arange(len(sets)), sheet.system.mesh, among)
    blocks, density = touched_blocks(sheet, cuts)
    own = _once(cuts, len(sheet.before))
    element = cuts.element[own]
    whole = with_contacts(blocks[own], element, density[own], sheet.system.contacts)
    return Blocks(cuts.of_set[own], element, without_middle(whole))


def _once(cuts: Cuts, n_elements: int) -> Index:
    """Return which elements count where touches of a set overlap: covered ones before cut ones, the last of those."""
    key = cuts.of_set * n_elements + cuts.element
    covered = np.arange(len(key)) >= cuts.n_cut
    order = np.lexsort((covered, key))
    last = np.append(key[order][1:] != key[order][:-1], True) if len(order) else np.zeros(0, dtype=np.bool_)
    return np.asarray(order[last])


def rates(sheet: AssembledSheet, pieces: Array, free: npt.NDArray[np.bool_], base: Blocks) -> Rates:
    """Return the rates of the blocks of one touch set.

    Args:
        sheet: The deformation.
        pieces: (n, 8) the touches.
        free: (n, 7) bool, by which parameters.
        base: The set's blocks.
    """
    mesh = sheet.system.mesh
    ways = ways_of(pieces, free, mesh)
    if not len(ways.touch):
        none = np.zeros(0, dtype=np.intp)
        return Rates(ways.mix, none, np.zeros(1, dtype=np.intp), np.zeros((0, BLOCK, BLOCK)))
    near, sets = [np.flatnonzero(row) for row in ways.near], []
    for one, row in zip(ways.touch.tolist(), ways.moved, strict=True):
        own = pieces[near[one]]
        own[near[one] == one] = row
        sets.append(own)
    varied = touched(sheet, sets, ways.reach)
    place = np.full(len(sheet.before), -1, dtype=np.intp)
    place[base.element] = np.arange(len(base.element))
    at = place[varied.element]
    before = np.where((at >= 0)[:, None, None], base.blocks[at], sheet.before[varied.element])
    change = (varied.blocks - before) / ways.step[varied.of_set][:, None, None]
    # A neighbour's elements that the moved touch does not reach stay as they were but for rounding.
    changed = np.abs(varied.blocks - before).max(axis=(1, 2)) > 1e-13 * np.abs(before).max(axis=(1, 2))
    first = np.searchsorted(varied.of_set[changed], np.arange(len(ways.touch) + 1))
    return Rates(ways.mix, varied.element[changed], first.astype(np.intp), change[changed])


__all__ = ["COUNT", "Blocks", "Rates", "rates", "touched"]
