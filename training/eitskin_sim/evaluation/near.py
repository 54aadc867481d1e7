"""Matches the true touches with those of a map: a touch is missed if none is found near it."""

from typing import Final

import numpy as np
from scipy.spatial.distance import cdist

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.arrays import Array
from eitskin_sim.evaluation.metrics import touch_centres_mm, truth_level

MAX_MATCH_DISTANCE_MM: Final = 15.0
"""A touch is missed if none is found this near to it."""


def true_centres_mm(truth: Array, grid: Grid = PAPER.grid) -> Array:
    """Return the (touches, 2) places of a truth's touches, also of such as nowhere cover half a pixel."""
    return touch_centres_mm(truth, grid, truth_level(truth))


def distances_mm(image: Array, truth: Array, grid: Grid = PAPER.grid) -> Array:
    """Return (true touches,) mm from each to the nearest that a map shows; infinite where it shows none."""
    true, found = true_centres_mm(truth, grid), touch_centres_mm(image, grid)
    return np.asarray(cdist(true, found).min(axis=1) if len(found) else np.full(len(true), np.inf))


def missed_and_rms(distance_mm: Array) -> tuple[float | None, float | None]:
    """Return the share of touches that are missed, and the root mean square distance of the others; None for none."""
    near = distance_mm[distance_mm <= MAX_MATCH_DISTANCE_MM]
    missed = float(np.mean(distance_mm > MAX_MATCH_DISTANCE_MM)) if distance_mm.size else None
    return missed, float(np.sqrt(np.mean(near**2))) if near.size else None
