"""Checks whether points form rows parallel to a side of the sheet, like a regular grid.

The border of such a set is not visible: it is on the outermost row, or up to one row's distance beyond it. Rows are
found by the depth's Fourier sum: with n points without rows its size is about 1 / sqrt(n) of the whole, with rows 1.
"""

from typing import Final

import numpy as np

from eitskin_sim.arrays import Array

DEPTH_ROWS: Final = 8.0
"""How deep under the side rows are looked for, in mean distances of the points."""

DISTANCES: Final = np.geomspace(0.6, 1.7, 100)
"""Distances of rows that are tried, in mean distances of the points."""

BINS: Final = 12
"""Bins of depth in a mean distance."""

MIN_COHERENCE: Final = 0.6
"""A Fourier sum of this part of the points means rows: in a grid that is jittered by a fifth of its distance it is
0.45."""


def find_rows(depth_mm: Array, density: float) -> tuple[float, float] | None:
    """Return the depth of the outermost row and the rows' distance, in mm; None where points have no rows.

    Args:
        depth_mm: (n,) distances of points inwards from a side.
        density: Points per square millimetre.
    """
    spacing = 1.0 / float(np.sqrt(density))
    depth = depth_mm[(depth_mm < DEPTH_ROWS * spacing) & (depth_mm > -spacing)]
    if len(depth) < 2.0 * DEPTH_ROWS:
        return None
    distances = DISTANCES * spacing
    bins = np.floor((depth / spacing + 1.0) * BINS).astype(np.intp)
    weight = np.bincount(bins) / len(depth)
    middle = ((np.arange(len(weight)) + 0.5) / BINS - 1.0) * spacing
    sums = weight @ np.exp(2j * np.pi * middle[:, None] / distances)
    best = int(np.argmax(np.abs(sums)))
    if np.abs(sums[best]) < MIN_COHERENCE:
        return None
    distance = float(distances[best])
    first = float(np.angle(sums[best])) / (2.0 * np.pi) * distance
    row = np.round((depth - first) / distance).astype(np.intp)
    count = np.bincount(row - row.min())
    outermost = int(np.argmax(count > 0.3 * count.max())) + int(row.min())  # a stray point is no row
    return float(np.mean(depth[row == outermost])), distance
