"""Measures whether the sheet moved during a capture: the means of its parts then vary by more than noise.

With b parts of n frames, noise of variance s^2 a frame gives their means the variance s^2 / n. A sheet that bends, or a
touch that comes or goes, adds to it. Of every row, ::

    moved^2 = variance of the parts' means - s^2 / n        s^2 = mean of (frame - frame before)^2 / 2

and the movement is the root of the mean of moved^2 / V^2 over the rows, each with the weight 1 / (1 %^2 + s^2 / n V^2),
so that rows that drown in noise count little. Differences of successive frames hardly contain slow movement but all of
the noise; mains hum, which changes as fast, counts as noise.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

PARTS: Final = 10
MIN_PART_FRAMES: Final = 4
"""Most parts of a capture, and fewest frames in one; fewer than two parts say nothing."""

MAX_VARIANCE_RATIO: Final = 3.0
"""Noise alone exceeds this multiple of the expected variance of ten means once in a thousand captures, even if it is
the same in all rows."""

EQUAL_WEIGHT_SPREAD: Final = 0.01
"""Rows whose parts are known better than this all count the same."""


def movement_of(voltages: Array, left_out: npt.NDArray[np.bool_] | None = None) -> float:
    """Return how far the means of the parts wander, in parts of the voltage; 0 if noise may be all there is.

    Args:
        voltages: (n, rows) V.
        left_out: (rows,) rows that say nothing; None for none.
    """
    parts, mean = min(PARTS, len(voltages) // MIN_PART_FRAMES), voltages.mean(axis=0)
    if parts < 2:
        return 0.0
    rows = mean != 0.0 if left_out is None else (mean != 0.0) & ~left_out
    found, square = voltages[:, rows], mean[rows] ** 2
    wander = np.var([part.mean(axis=0) for part in np.array_split(found, parts)], axis=0, ddof=1) / square
    noise = np.mean(np.diff(found, axis=0) ** 2, axis=0) / 2.0 * parts / len(voltages) / square
    weight = 1.0 / (EQUAL_WEIGHT_SPREAD**2 + noise)
    moved, expected = float(weight @ wander), float(weight @ noise)
    return 0.0 if moved <= MAX_VARIANCE_RATIO * expected else float(np.sqrt((moved - expected) / weight.sum()))
