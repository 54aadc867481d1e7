"""Smooth unevenness of the layer as a few modes, each of prior standard deviation 1.

The covariance of log conductivity at two points is that of the skin's own law, averaged over the bounds it states ::

    C(x, y) = <rms^2> <exp(-|x - y|^2 / (2 l^2))>

Modes are its leading eigenfunctions on a grid, carried to any point by the kernel itself (Nystroem).
"""

from typing import Final

import numpy as np

from eitskin_proto.skin.parts import Range
from eitskin_sim.arrays import Array

GRID_MM: Final = 10.0
"""Distance of the grid's points: below half of the shortest correlation length that matters."""

VARIANCE_SHARE: Final = 0.998
"""Share of the variance that the modes have."""

MAX_MODES: Final = 60
LENGTHS: Final = 5
"""Correlation lengths that stand for their range."""


class SmoothModes:
    """Modes of one field.

    Args:
        size_mm: Of the sheet.
        rms: From, to; the square's mean is the variance.
        correlation_mm: From, to.
    """

    def __init__(self, size_mm: tuple[float, float], rms: Range, correlation_mm: Range) -> None:
        low, high = rms
        self.variance = float((low * low + low * high + high * high) / 3.0)
        """Of log conductivity at a point."""
        self._lengths = np.linspace(*correlation_mm, LENGTHS)
        sides = [(np.arange(n) + 0.5) * extent / n for extent in size_mm for n in [max(2, round(extent / GRID_MM))]]
        x, y = np.meshgrid(*sides)
        self._grid = np.stack([x.ravel(), y.ravel()], axis=-1)
        self.count = 0
        self._to_modes = np.zeros((len(self._grid), 0))
        if self.variance:
            size, vectors = np.linalg.eigh(self._kernel(self._grid))
            size, vectors = size[::-1], vectors[:, ::-1]
            share = np.cumsum(size) / size.sum()
            self.count = min(int(np.searchsorted(share, VARIANCE_SHARE)) + 1, MAX_MODES)
            self._to_modes = vectors[:, : self.count] / np.sqrt(size[: self.count])

    def at(self, xy_mm: Array) -> Array:
        """Return (n, count) values of the modes at flat points (n, 2)."""
        return np.asarray(self._kernel(xy_mm) @ self._to_modes)

    def _kernel(self, xy_mm: Array) -> Array:
        apart = ((xy_mm[:, None, :] - self._grid[None, :, :]) ** 2).sum(axis=-1)
        found = np.zeros_like(apart)
        for length in self._lengths:
            found += np.exp(-apart / (2.0 * length * length))
        return np.asarray(self.variance / LENGTHS * found)
