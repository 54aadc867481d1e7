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

from eitskin_proto.sensor.table import N_ROWS

Array = npt.NDArray[np.float64]

PARTS: Final = 10
MIN_PART_FRAMES: Final = 4
"""Most parts of a capture, and fewest frames in one; fewer than two parts say nothing."""

MAX_VARIANCE_RATIO: Final = 3.0
"""Noise alone exceeds this multiple of the expected variance of ten means once in a thousand captures, even if it is
the same in all rows."""

EQUAL_WEIGHT_SPREAD: Final = 0.01
"""Rows whose parts are known better than this all count the same."""


class Movement:
    """Takes frame after frame; allocates nothing a frame.

    Args:
        frames: How many will come.
        rows: Of a frame.
    """

    __slots__ = ("_before", "_count", "_frames", "_parts", "_step", "_steps", "_sums", "_taken")

    def __init__(self, frames: int, rows: int = N_ROWS) -> None:
        self._frames = frames
        self._parts = min(PARTS, frames // MIN_PART_FRAMES)
        self._taken = 0
        self._sums = np.zeros((max(self._parts, 1), rows))
        self._count = np.zeros(max(self._parts, 1))
        self._before = np.zeros(rows)
        self._step = np.zeros(rows)
        self._steps = np.zeros(rows)

    def add(self, voltages: Array) -> None:
        """Take one frame, (rows,) V."""
        part = min(self._taken * self._parts // self._frames, max(self._parts - 1, 0))
        np.add(self._sums[part], voltages, out=self._sums[part])
        self._count[part] += 1.0
        if self._taken:
            np.subtract(voltages, self._before, out=self._step)
            np.multiply(self._step, self._step, out=self._step)
            np.add(self._steps, self._step, out=self._steps)
        np.copyto(self._before, voltages)
        self._taken += 1

    def relative(self, mean: Array) -> float:
        """Return how far the means of the parts wander, in parts of the voltage; 0 if noise may be all there is.

        Args:
            mean: (rows,) V, of all frames; rows of 0 are left out.
        """
        if self._parts < 2 or self._taken < self._frames:
            return 0.0
        rows = mean != 0.0
        square = mean[rows] ** 2
        wander = np.var(self._sums[:, rows] / self._count[:, None], axis=0, ddof=1) / square
        noise = self._steps[rows] / (2.0 * (self._taken - 1)) / float(self._count.mean()) / square
        weight = 1.0 / (EQUAL_WEIGHT_SPREAD**2 + noise)
        found, expected = float(weight @ wander), float(weight @ noise)
        return 0.0 if found <= MAX_VARIANCE_RATIO * expected else float(np.sqrt((found - expected) / weight.sum()))
