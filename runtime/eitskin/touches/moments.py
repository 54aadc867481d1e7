"""Computes place, area and axes of each touch from moments of the map over its pixels.

A pixel's value is its touched share. So a touch's area is the sum of its pixels' shares, and its centre their mean.
Pixels cut by the border may be below one half, so the pixels right around a piece count as well, divided equally where
they are around several pieces. For a map of touched shares both are exact except for the border within one pixel.

The axes are those of the ellipse with the same second moments: a disc of 10 mm has two of 10 mm, a square of side s two
of 1.155 s. Shares in pixels of side p spread a touch by p^2 / 12 along x and y, on average over its position; this is
subtracted.
"""

import math
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.touches.pieces import Indices, pieces
from eitskin_proto.skin.grid import Grid

Array = npt.NDArray[np.float64]

MOST_TOUCHES: Final = 16
"""Most touches of one map that are listed: those with the largest sum of pixels of at least one half."""

BELOW_PI: Final = float(np.nextafter(np.float32(np.pi), np.float32(0.0)))
"""The largest angle of a message, in which the next number of 4 bytes is more than pi."""

Row = tuple[float, float, float, float, float, float, float]
"""x and y of a touch's centre in mm, its longer and shorter axis in mm, angle in rad, area in mm2, peak."""


@dataclass(slots=True, eq=False)
class Found:
    """The touches of one map, in the order of their first pixels; not modified."""

    rows: list[Row]
    """Of each touch."""
    pixels: Indices
    """(m,) pixels that some touch has a part of, by their number in the map with its border; touch after touch.

    One that is at least half touched is of one touch alone."""
    touch: Indices
    """(m,) the touch of each."""
    weights: Array
    """(m,) the share of the pixel that this touch has."""
    starts: Indices
    """(n,) where each touch begins among them."""
    pixel_mm2: float
    """Of the grid."""
    more: int
    """Touches that are not listed, since there are more than ``MOST_TOUCHES``; or 1, if the map is in shreds."""
    doubts: list[tuple[float, float, float, float]] = field(default_factory=list)
    """Of each touch its errors along x and y in mm, amplitude, log likelihood ratio; empty where they are unknown."""

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.rows)

    @property
    def numbers(self) -> Array:
        """(7, n): the rows as an array, one column a touch."""
        return np.array(self.rows, dtype=np.float64).reshape(-1, 7).T

    def areas_mm2(self, stretch: Array) -> list[float]:
        """Return the area of each touch on a surface.

        Args:
            stretch: (pixels,) surface over flat area at each pixel of a map with its border.
        """
        if not self.rows:
            return []
        areas: list[float] = np.add.reduceat(self.weights * stretch[self.pixels], self.starts).tolist()
        return [area * self.pixel_mm2 for area in areas]


class TouchFinder:
    """Finds the touches of one map after another.

    Args:
        grid: Of the skin.
    """

    __slots__ = (
        "_around", "_blur_mm2", "_flat", "_inside", "_middle_mm", "_pixel_mm2", "_powers", "_touch", "_width",
        "nothing",
    )  # fmt: skip

    def __init__(self, grid: Grid) -> None:
        rows, columns = grid.shape
        self._width = columns + 2
        padded = np.zeros((rows + 2, columns + 2))
        self._inside = padded[1:-1, 1:-1]
        self._flat = padded.reshape(-1)
        dx, dy = grid.pixel_mm
        self._pixel_mm2 = grid.pixel_mm2
        self._blur_mm2 = dx * dx / 12.0, dy * dy / 12.0
        self._middle_mm = 0.5 * grid.size_mm[0], 0.5 * grid.size_mm[1]
        row, column = np.divmod(np.arange(self._flat.size), self._width)
        x, y = (column - 0.5) * dx - grid.size_mm[0] / 2, (row - 0.5) * dy - grid.size_mm[1] / 2
        self._powers = np.stack([np.ones_like(x), x, y, x * x, y * y, x * y])
        steps = [down * self._width + right for down in (-1, 0, 1) for right in (-1, 0, 1)]
        self._around = np.array(steps, dtype=np.intp)[:, np.newaxis]
        self._touch = np.arange(MOST_TOUCHES)
        self.nothing = self._without(0)
        """No touches."""

    def _without(self, more: int) -> Found:
        whole = np.zeros(0, dtype=np.intp)
        return Found([], whole, whole, np.zeros(0), whole, self._pixel_mm2, more)

    def find(self, values: npt.NDArray[np.floating]) -> Found:
        """Return the touches of a map.

        Args:
            values: (pixels,) or (rows, columns). Those below 0 and those that are not finite count as 0.
        """
        self._inside[:] = values.reshape(self._inside.shape)
        flat = self._flat
        if not math.isfinite(flat.dot(flat)):
            flat[~np.isfinite(flat)] = 0.0
        found = pieces(flat, self._width)
        if found is None:
            return self._without(1)
        core, of, count = found
        if count == 0:
            return self.nothing
        more = count - MOST_TOUCHES
        if more > 0:
            core, of = _largest(core, of, np.bincount(of, flat[core], count))
            count = MOST_TOUCHES
        # Each touch has its own pixels, and a part of the pixels around them that belong to no touch.
        touched = np.zeros(count * flat.size, dtype=bool)
        own = of * flat.size
        own += core
        touched[own + self._around] = True
        if count > 1:
            touched.reshape(count, flat.size)[:, core] = False
            touched[own] = True
        pixels = touched.nonzero()[0]
        touch = pixels // flat.size
        pixels -= touch * flat.size
        weights = np.maximum(flat[pixels], 0.0)
        if count > 1:
            weights /= np.bincount(pixels)[pixels]
        starts = touch.searchsorted(self._touch[:count])
        sums = np.add.reduceat(self._powers.take(pixels, axis=1) * weights, starts, axis=1)
        peaks = np.zeros(count)
        np.maximum.at(peaks, of, flat[core])
        rows = list(map(self._row, *sums.tolist(), peaks.tolist()))
        return Found(rows, pixels, touch, weights, starts, self._pixel_mm2, max(more, 0))

    def _row(self, total: float, x: float, y: float, xx: float, yy: float, xy: float, peak: float) -> Row:
        """Return the numbers of a touch from the sums of its shares times 1, x, y, x^2, y^2 and x y."""
        x, y = x / total, y / total
        xx, yy, xy = xx / total - x * x - self._blur_mm2[0], yy / total - y * y - self._blur_mm2[1], xy / total - x * y
        middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
        spread = math.sqrt(half * half + xy * xy)
        angle = 0.5 * math.atan2(xy, half) % math.pi
        return (
            x + self._middle_mm[0], y + self._middle_mm[1],
            4.0 * math.sqrt(max(middle + spread, 0.0)), 4.0 * math.sqrt(max(middle - spread, 0.0)),
            angle if angle <= BELOW_PI else 0.0,  # of a negative one next to 0
            total * self._pixel_mm2, peak,
        )  # fmt: skip


def _largest(core: Indices, of: Indices, sums: npt.NDArray[Any]) -> tuple[Indices, Indices]:
    """Return pixels and pieces of those with the largest sums, renumbered; of equal ones, the first."""
    kept = np.sort(np.argsort(-sums, kind="stable")[:MOST_TOUCHES])
    rank = np.full(sums.size, -1, dtype=np.intp)
    rank[kept] = np.arange(kept.size)
    mine = rank[of] >= 0
    return core[mine], rank[of[mine]]
