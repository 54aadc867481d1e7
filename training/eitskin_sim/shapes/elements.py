"""The blocks of the elements that touches cover or cut, and their derivatives by every parameter of every touch.

Blocks are those of the generators (:mod:`eitskin_sim.freeform.sheet`), by the one rule for cut elements; where touches
overlap an element is covered once. A rate is a difference quotient of a touch's own few elements, all moves at once: no
system is solved for it, and whatever the rule is, these are its own derivatives. An upright rectangle with sharp sides
moves side by side: the right one changes the elements that it crosses and no others, and ::

    d / dx = d / d right - d / d left          d / d half length = d / d right + d / d left

with sides counted outwards. So an element is computed for the sides that cross it, not for all parameters.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.borders.cut_touches import Cuts, find_cuts
from eitskin_sim.fem.mesh import TensorMesh
from eitskin_sim.freeform.mesh import with_contacts, without_middle
from eitskin_sim.freeform.sheet import AssembledSheet, touched_blocks
from eitskin_sim.scene.gap import half_extents_mm
from eitskin_sim.scene.soft_touch import MIN_BORDER_MM
from eitskin_sim.scene.touch_table import RECTANGLE, TouchTable
from eitskin_sim.shapes.parameters import ANGLE, BORDER, HALF_LENGTH, X, parameters_of, pieces_of

BLOCK: Final = 9
"""Unknowns of an element: its eight outer nodes and the electrode over it."""

DIFFERENCE_STEP: Final = 1e-5
"""mm, rad, or of log contrast."""

BAND_MM: Final = 100.0 * DIFFERENCE_STEP
"""About a side, within which elements count as crossed."""

SIDES: Final = slice(X, HALF_LENGTH + 2)
"""The parameters of an upright rectangle that its sides make up."""


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
    moves = moves_of(pieces, free, mesh)
    if not len(moves.touch):
        none = np.zeros(0, dtype=np.intp)
        return Rates(moves.mix, none, np.zeros(1, dtype=np.intp), np.zeros((0, BLOCK, BLOCK)))
    near, sets = [np.flatnonzero(row) for row in moves.near], []
    for one, row in zip(moves.touch.tolist(), moves.moved, strict=True):
        own = pieces[near[one]]
        own[near[one] == one] = row
        sets.append(own)
    varied = touched(sheet, sets, moves.reach)
    place = np.full(len(sheet.before), -1, dtype=np.intp)
    place[base.element] = np.arange(len(base.element))
    at = place[varied.element]
    before = np.where((at >= 0)[:, None, None], base.blocks[at], sheet.before[varied.element])
    change = (varied.blocks - before) / moves.step[varied.of_set][:, None, None]
    # A neighbour's elements that the moved touch does not reach stay as they were but for rounding.
    changed = np.abs(varied.blocks - before).max(axis=(1, 2)) > 1e-13 * np.abs(before).max(axis=(1, 2))
    first = np.searchsorted(varied.of_set[changed], np.arange(len(moves.touch) + 1))
    return Rates(moves.mix, varied.element[changed], first.astype(np.intp), change[changed])


@dataclass(frozen=True, slots=True)
class TouchMoves:
    """c moves of touches, and what r parameters are of them."""

    touch: Index
    """(c,) which touch moves."""
    moved: Array
    """(c, 8) the touch after it."""
    step: Array
    """(c,) how far, of either sign."""
    reach: npt.NDArray[np.bool_]
    """(c, n_elements) elements that it may change."""
    mix: Array
    """(c, r) derivatives by parameters, in the order of ``np.nonzero(free)``, from those by moves."""
    near: npt.NDArray[np.bool_]
    """(n, n) which touches share an element."""


def moves_of(pieces: Array, free: npt.NDArray[np.bool_], mesh: TensorMesh) -> TouchMoves:
    """Return the moves that derivatives by the (n, 7) free parameters of (n, 8) touches are made of."""
    values, number = parameters_of(pieces), np.cumsum(free.ravel()).reshape(free.shape) - 1
    boxes = _boxes(pieces)
    sharp = (pieces[:, 0] == RECTANGLE) & (pieces[:, 5] == 0.0) & (pieces[:, 7] == 0.0) & ~free[:, ANGLE]
    by_sides = sharp & free[:, SIDES].all(axis=1)
    others = free.copy()
    others[by_sides, SIDES] = False
    own = reached(boxes, mesh)

    side_of = np.repeat(np.flatnonzero(by_sides), 4)  # a touch's left, right, low and high side
    sides, at = values[side_of], np.arange(len(side_of))
    axis, outward = at // 2 % 2, at % 2 * 2 - 1
    where = sides[at, X + axis] + outward * sides[at, HALF_LENGTH + axis]
    sides[at, X + axis] += 0.5 * outward * DIFFERENCE_STEP
    sides[at, HALF_LENGTH + axis] += 0.5 * DIFFERENCE_STEP
    crossed = boxes[side_of]
    crossed[at, :, axis] = where[:, None] + (-BAND_MM, BAND_MM)

    one_of, which = np.nonzero(others)
    steps, moved = _steps(pieces[one_of], which), values[one_of]
    moved[np.arange(len(one_of)), which] += steps

    touch = np.concatenate([side_of, one_of])
    mix = np.zeros((len(touch), int(free.sum())))
    mix[at, number[side_of, X + axis]] = outward
    mix[at, number[side_of, HALF_LENGTH + axis]] = 1.0
    mix[len(at) + np.arange(len(one_of)), number[one_of, which]] = 1.0
    return TouchMoves(
        touch=touch,
        moved=pieces_of(pieces[touch, 0], np.concatenate([sides, moved])),
        step=np.concatenate([np.full(len(at), DIFFERENCE_STEP), steps]),
        reach=np.concatenate([reached(crossed, mesh), own[one_of]]),
        mix=mix,
        near=_sharing(own),
    )


def _sharing(reach: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return (n, n) which of n touches that reach (n, n_elements) share an element."""
    counted = reach.astype(np.float32)
    return np.asarray(counted @ counted.T > 0.0)


def reached(boxes: Array, mesh: TensorMesh) -> npt.NDArray[np.bool_]:
    """Return (n, n_elements) which elements meet (n, 2, 2) boxes, low and high corner each."""
    x, y = mesh.x_lines_mm, mesh.y_lines_mm
    across = (x[1:] > boxes[:, 0, :1]) & (x[:-1] < boxes[:, 1, :1])
    up = (y[1:] > boxes[:, 0, 1:]) & (y[:-1] < boxes[:, 1, 1:])
    return np.asarray((up[:, :, None] & across[:, None, :]).reshape(len(boxes), mesh.n_elements))


def _boxes(pieces: Array) -> Array:
    """Return (n, 2, 2) the boxes around touches and their borders."""
    half = half_extents_mm(pieces) + pieces[:, 7:8] / 2 + 10.0 * BAND_MM
    return np.stack([pieces[:, 1:3] - half, pieces[:, 1:3] + half], axis=1)


def _steps(pieces: Array, which: Index) -> Array:
    """Return (c,) steps of one parameter each: a border does not go beyond its bounds, nor a width below the border."""
    down = (which == BORDER) & (pieces[:, 7] > MIN_BORDER_MM + DIFFERENCE_STEP)
    return np.where(down, -DIFFERENCE_STEP, DIFFERENCE_STEP)
