"""Measures over how many frames a mean gains before drift takes over: the minimum of the Allan variance.

The Allan variance of means of n frames is half the mean square of the difference of neighbouring means. White noise
halves it whenever n doubles. Where it no longer falls, drift is as large as what is left of the noise.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

LEVELS: Final = 7
"""Means of 1, 2, 4 ... 64 frames."""


class Steadiness:
    """Takes frame after frame.

    Args:
        rows: Of a frame.
    """

    __slots__ = ("_pairs", "_squares", "_waiting")

    def __init__(self, rows: int) -> None:
        self._waiting: list[Array | None] = [None] * LEVELS
        self._squares, self._pairs = np.zeros((LEVELS, rows)), np.zeros(LEVELS)

    def add(self, voltages_V: Array) -> None:
        """Take one frame, (rows,) V."""
        mean = voltages_V.copy()
        for level in range(LEVELS):
            before, self._waiting[level] = self._waiting[level], None
            if before is None:
                self._waiting[level] = mean
                return
            self._squares[level] += np.square(mean - before)
            self._pairs[level] += 1
            mean = 0.5 * (mean + before)

    def frames(self, spread_V: Array) -> int:
        """Return over how many frames a mean gains, a power of two; as far as was seen.

        Args:
            spread_V: (rows,) V, standard deviation of a single frame, by which rows are compared.
        """
        known = self._pairs > 0
        size = np.where(spread_V > 0.0, spread_V, np.inf)
        variances = (self._squares[known] / np.square(size)).sum(axis=1) / self._pairs[known]
        rises = np.flatnonzero(np.diff(variances) > 0.0)
        return 1 << (int(rises[0]) if len(rises) else LEVELS - 1)
