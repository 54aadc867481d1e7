"""The blocks of the elements that touches cover or cut, and how they change with every parameter of every touch.

Blocks are those of the generators (:mod:`eitskin_sim.freeform.sheet`), by the one rule for cut elements; where touches
overlap an element is covered once. A rate is a difference quotient of a touch's own few elements, all parameters at
once: no system is solved for it, and whatever the rule is, these are its own derivatives, to ``STEP``.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.fem.borders.cut_touches import Cuts, find_cuts
from eitskin_sim.fem.mesh import Index, TensorMesh
from eitskin_sim.freeform.mesh import with_contacts, without_middle
from eitskin_sim.freeform.sheet import InvertedSheet, touched_blocks
from eitskin_sim.scene.gap import half_extents_mm
from eitskin_sim.scene.soft_touch import LEAST_BORDER_MM
from eitskin_sim.scene.touch_table import Array, TouchTable
from eitskin_sim.shapes.parameters import BORDER, COUNT, parameters_of, pieces_of

STEP: Final = 1e-5
"""mm, rad, or of log contrast."""

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
    """How blocks change with r parameters."""

    touch: Index
    """(r,) whose parameter."""
    parameter: Index
    """(r,) which."""
    element: Index
    """(q,) elements, parameter after parameter."""
    first: Index
    """(r + 1,) where those of each begin."""
    blocks: Array
    """(q, 9, 9) S by mm, rad, or 1."""


def touched(sheet: InvertedSheet, sets: list[Array]) -> Blocks:
    """Return what touch sets, (n, 8) pieces each, make of a sheet's elements, sorted by set and element.

    Raises:
        ValueError: A border cannot be represented, or a piece would change nothing.
    """
    first = np.concatenate([[0], np.cumsum([len(one) for one in sets])]).astype(np.int64)
    table = TouchTable(np.concatenate(sets), first)
    cuts = find_cuts(table, np.arange(len(sets)), sheet.system.mesh)
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


def rates(sheet: InvertedSheet, pieces: Array, free: npt.NDArray[np.bool_], base: Blocks) -> Rates:
    """Return the rates of the blocks of one touch set.

    Args:
        sheet: The deformation.
        pieces: (n, 8) the touches.
        free: (n, 7) bool, by which parameters.
        base: The set's blocks.
    """
    touch, parameter = np.nonzero(free)
    kinds, values = pieces[:, 0], parameters_of(pieces)
    near = _neighbours(pieces, sheet.system.mesh)
    sets = []
    for one, which in zip(touch.tolist(), parameter.tolist(), strict=True):
        moved = values.copy()
        # A border may be as wide as its touch already, or as narrow as one may be.
        moved[one, which] += _sign(pieces[one], which) * STEP
        sets.append(pieces_of(kinds, moved)[near[one]])
    if not sets:
        none = np.zeros(0, dtype=np.intp)
        return Rates(touch, parameter, none, np.zeros(1, dtype=np.intp), np.zeros((0, BLOCK, BLOCK)))
    varied = touched(sheet, sets)
    place = np.full(len(sheet.before), -1, dtype=np.intp)
    place[base.element] = np.arange(len(base.element))
    at = place[varied.element]
    before = np.where((at >= 0)[:, None, None], base.blocks[at], sheet.before[varied.element])
    signs = [_sign(pieces[one], which) for one, which in zip(touch.tolist(), parameter.tolist(), strict=True)]
    sign = STEP * np.array(signs)[varied.of_set]
    change = (varied.blocks - before) / sign[:, None, None]
    # A neighbour's elements that the moved touch does not reach stay as they were but for rounding, and the element of
    # a neighbour that is left out of this set is not among them.
    own = np.abs(varied.blocks - before).max(axis=(1, 2)) > 1e-13 * np.abs(before).max(axis=(1, 2))
    reach = _reach(pieces, sheet.system.mesh)
    own &= reach[touch[varied.of_set], varied.element]
    of_set = varied.of_set[own]
    first = np.searchsorted(of_set, np.arange(len(touch) + 1))
    return Rates(touch, parameter, varied.element[own], first.astype(np.intp), change[own])


def _sign(piece: Array, parameter: int) -> float:
    """Return which way a parameter may go: a border not beyond its bounds, nor a width below the border."""
    return -1.0 if parameter == BORDER and piece[7] > LEAST_BORDER_MM + STEP else 1.0


def _reach(pieces: Array, mesh: TensorMesh) -> Array:
    """Return (n, n_elements) which elements meet the box around a touch and its border."""
    half = half_extents_mm(pieces) + pieces[:, 7:8] / 2 + 10 * STEP * 100.0
    low, high = pieces[:, 1:3] - half, pieces[:, 1:3] + half
    x, y = mesh.x_lines_mm, mesh.y_lines_mm
    across = (x[1:] > low[:, :1]) & (x[:-1] < high[:, :1])
    up = (y[1:] > low[:, 1:]) & (y[:-1] < high[:, 1:])
    return np.asarray((up[:, :, None] & across[:, None, :]).reshape(len(pieces), -1))


def _neighbours(pieces: Array, mesh: TensorMesh) -> list[Index]:
    """Return for every touch those that share an element with it, itself among them."""
    reach = _reach(pieces, mesh)
    shared = reach.astype(np.float32) @ reach.T.astype(np.float32)
    return [np.flatnonzero(row) for row in shared > 0.0]


__all__ = ["COUNT", "Blocks", "Rates", "rates", "touched"]
