"""Where each touch is, how large, and along which axes: moments of the map over its pixels.

A pixel's value is the touched share of it. So a touch's area is the sum of its pixels' shares, and its centre their
mean, whichever side of one half the pixels lie on that its border cuts: the pixels right around a piece count as well,
by equal parts where they are right around several. Of a map of touched shares both are exact but for what a border
does within one pixel.

The axes are those of the ellipse with the same second moments: a disc of 10 mm has two of 10 mm, a square of side s
two of 1.155 s. Shares in pixels of side p spread a touch by p^2 / 12 along x and y, on average over where it lies; so
much is taken off.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.touches.pieces import Indices, pieces
from eitskin_proto.skin.grid import Grid

Array = npt.NDArray[np.float64]

MOST_TOUCHES: Final = 16
"""Touches of one map that are listed: those whose pixels of at least one half sum up to most."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The touches of one map, as arrays with one row a touch, in the order of their first pixels."""

    numbers: Array
    """(7, n): x and y of the centre in mm, longer and shorter axis in mm, angle in rad, area in mm2, peak."""
    pixels: Indices
    """(m,) pixels that some touch has a part of, by their number in the map with its border."""
    touch: Indices
    """(m,) the touch of each."""
    weights: Array
    """(m,) the share of the pixel that this touch has."""
    core: Indices
    """(k,) pixels at least half touched, by their number in the map with its border."""
    core_touch: Indices
    """(k,) the touch of each."""
    pixel_mm2: float
    """Of the grid."""
    more: int
    """Touches that are not listed, since there are more than ``MOST_TOUCHES``; or 1, if the map is in shreds."""

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.numbers[0])


class Finder:
    """Finds the touches of one map after another.

    Args:
        grid: Of the skin.
    """

    __slots__ = ("_around", "_blur_mm2", "_empty", "_flat", "_inside", "_middle_mm", "_pixel_mm2", "_powers", "_width")

    def __init__(self, grid: Grid) -> None:
        rows, columns = grid.shape
        self._width = columns + 2
        padded = np.zeros((rows + 2, columns + 2))
        self._inside = padded[1:-1, 1:-1]
        self._flat = padded.reshape(-1)
        dx, dy = grid.pixel_mm
        self._pixel_mm2 = grid.pixel_mm2
        self._blur_mm2 = np.array([[dx * dx], [dy * dy]]) / 12.0
        self._middle_mm = 0.5 * np.array(grid.size_mm)[:, np.newaxis]
        row, column = np.divmod(np.arange(self._flat.size), self._width)
        x, y = (column - 0.5) * dx - grid.size_mm[0] / 2, (row - 0.5) * dy - grid.size_mm[1] / 2
        self._powers = np.stack([np.ones_like(x), x, y, x * x, y * y, x * y])
        steps = [down * self._width + right for down in (-1, 0, 1) for right in (-1, 0, 1)]
        self._around = np.array(steps, dtype=np.intp)[:, np.newaxis]
        self._empty = self._nothing(0)

    @property
    def nothing(self) -> Found:
        """No touches."""
        return self._empty

    def _nothing(self, more: int) -> Found:
        whole = np.zeros(0, dtype=np.intp)
        return Found(np.zeros((7, 0)), whole, whole, np.zeros(0), whole, whole, self._pixel_mm2, more)

    def find(self, values: npt.NDArray[np.floating]) -> Found:
        """Return the touches of a map.

        Args:
            values: (pixels,) or (rows, columns). Those below 0 and those that are not finite count as 0.
        """
        self._inside[:] = values.reshape(self._inside.shape)
        flat = self._flat
        if not np.isfinite(np.dot(flat, flat)):
            flat[~np.isfinite(flat)] = 0.0
        found = pieces(flat, self._width)
        if found is None:
            return self._nothing(1)
        core, of, count = found
        if count == 0:
            return self._empty
        more = count - MOST_TOUCHES
        if more > 0:
            core, of = _largest(core, of, np.bincount(of, flat[core], count))
            count = MOST_TOUCHES
        # Each touch has its own pixels, and a part of those around them that are nobody's own.
        touched = np.zeros(count * flat.size, dtype=bool)
        own = of * flat.size
        own += core
        touched[own + self._around] = True
        touched.reshape(count, flat.size)[:, core] = False
        touched[own] = True
        touch, pixels = np.divmod(touched.nonzero()[0], flat.size)
        weights = np.maximum(flat[pixels], 0.0)
        weights /= np.bincount(pixels, minlength=1)[pixels]
        each = np.bincount(touch, minlength=count)
        sums = np.add.reduceat(self._powers.take(pixels, axis=1) * weights, each.cumsum() - each, axis=1)
        numbers = np.empty((7, count))
        total = sums[0]
        mean, square = sums[1:3] / total, sums[3:5] / total
        square -= mean * mean
        square -= self._blur_mm2
        cross = sums[5] / total - mean[0] * mean[1]
        middle, half = 0.5 * (square[0] + square[1]), 0.5 * (square[0] - square[1])
        spread = np.sqrt(half * half + cross * cross)
        np.add(mean, self._middle_mm, out=numbers[:2])
        numbers[2], numbers[3] = middle + spread, middle - spread
        numbers[2:4] = 4.0 * np.sqrt(np.maximum(numbers[2:4], 0.0))
        angle = 0.5 * np.arctan2(cross, half) % np.pi
        angle[angle >= np.pi] = 0.0  # of a negative one next to 0
        numbers[4] = angle
        np.multiply(total, self._pixel_mm2, out=numbers[5])
        order = of.argsort(kind="stable")
        sizes = np.bincount(of, minlength=count)
        np.maximum.reduceat(flat[core[order]], sizes.cumsum() - sizes, out=numbers[6])
        return Found(numbers, pixels, touch, weights, core, of, self._pixel_mm2, max(more, 0))


def _largest(core: Indices, of: Indices, sums: npt.NDArray[Any]) -> tuple[Indices, Indices]:
    """Return pixels and pieces of those of the largest sums, numbered anew; of equal ones, the first."""
    kept = np.sort(np.argsort(-sums, kind="stable")[:MOST_TOUCHES])
    rank = np.full(sums.size, -1, dtype=np.intp)
    rank[kept] = np.arange(kept.size)
    mine = rank[of] >= 0
    return core[mine], rank[of[mine]]
