"""The gap between two pieces, many pairs at once: rectangles at any angle, discs and ellipses.

Rectangles apart have an axis, normal to one of their four pairs of sides, on which their shadows are apart. The widest
gap between shadows is the distance, or less where corner faces corner: nothing is ever taken for further apart than it
is. An ellipse counts as the rectangle around it.
"""

import numpy as np

from eitskin_sim.arrays import Array
from eitskin_sim.scene.touch_table import DISC, ELLIPSE


def gap_mm(one: Array, other: Array) -> Array:
    """Return (n,) gaps between (n, 7) pieces, mm; below zero where they overlap."""
    shift = other[:, 1:3] - one[:, 1:3]
    ours, theirs = one[:, 0] == DISC, other[:, 0] == DISC
    found = np.max([_apart(one, other, shift, ~ours), _apart(other, one, shift, ~theirs)], axis=0)
    for disc, piece, rows in ((one, other, ours & ~theirs), (other, one, theirs & ~ours)):
        found[rows] = _from_rectangle(piece[rows], disc[rows, 1:3]) - disc[rows, 3] / 2
    both = ours & theirs
    found[both] = np.hypot(*shift[both].T) - (one[both, 3] + other[both, 3]) / 2
    return np.asarray(found)


def half_extents_mm(pieces: Array) -> Array:
    """Return the (n, 2) half sides of the upright boxes around (n, 7) pieces, mm."""
    if not pieces[:, 5].any() and not (pieces[:, 0] == DISC).any():
        return np.asarray(pieces[:, 3:5] / 2)
    cos, sin = (np.abs(f(np.deg2rad(pieces[:, 5]))) for f in (np.cos, np.sin))
    half, across = pieces[:, 3] / 2, pieces[:, 4] / 2
    round_ones = pieces[:, 0] == DISC
    x = np.where(round_ones, half, cos * half + sin * across)
    y = np.where(round_ones, half, sin * half + cos * across)
    ovals = pieces[:, 0] == ELLIPSE
    x = np.where(ovals, np.hypot(cos * half, sin * across), x)
    y = np.where(ovals, np.hypot(sin * half, cos * across), y)
    return np.stack([x, y], axis=-1)


def _apart(one: Array, other: Array, shift: Array, valid: Array) -> Array:
    """Return the wider gap between shadows on the two axes of ``one``."""
    turn = np.deg2rad(one[:, 5])
    between = np.deg2rad(other[:, 5]) - turn
    cos, sin = np.abs(np.cos(between)), np.abs(np.sin(between))
    along = np.abs(np.cos(turn) * shift[:, 0] + np.sin(turn) * shift[:, 1])
    across = np.abs(np.cos(turn) * shift[:, 1] - np.sin(turn) * shift[:, 0])
    length, width = other[:, 3] / 2, other[:, 4] / 2
    first = along - one[:, 3] / 2 - (cos * length + sin * width)
    second = across - one[:, 4] / 2 - (sin * length + cos * width)
    return np.where(valid, np.maximum(first, second), -np.inf)


def _from_rectangle(pieces: Array, points: Array) -> Array:
    """Return (n,) signed distances of (n, 2) points from (n, 7) rectangles."""
    offset = points - pieces[:, 1:3]
    turn = np.deg2rad(pieces[:, 5])
    cos, sin = np.cos(turn), np.sin(turn)
    along = np.abs(cos * offset[:, 0] + sin * offset[:, 1]) - pieces[:, 3] / 2
    across = np.abs(cos * offset[:, 1] - sin * offset[:, 0]) - pieces[:, 4] / 2
    outside = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
    return np.asarray(outside + np.minimum(np.maximum(along, across), 0.0))
