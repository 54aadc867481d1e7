"""The sheet's outline on its rolled-out chart: four sides, a little curved, and from them a square to draw on.

The chart of :mod:`eitskin_sim.surface.unroll` is a rectangle up to place, rotation and what twist and bumps do to it.
Its pose is that of the smallest box around it. Each side is then found strip by strip from the *density* of the points:
with rho points per millimetre inside, the side lies where the points beyond a line would fill rho up. An extreme point
would lie too far out by two or three times the noise, and too far in where points are few. A cubic through the strips
rides over notches. ::

        v |  ____top(u)____            a = (u - left(v)) / (right(v) - left(v))
          | |left          |right      b = (v - bottom(u)) / (top(u) - bottom(u))
          | |__bottom(u)___|           0 <= a, b <= 1 on the sheet, exactly 0 or 1 on its sides
          +------------------ u
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.spatial import ConvexHull

Array = npt.NDArray[np.float64]

STRIP_MM: Final = 5.0
"""Width of the strips in which a side is looked for."""

STRIP_POINTS: Final = 12.0
"""A cloud of few points has wider strips, so that this many points give each its density."""

SEARCH_MM: Final = 4.0
"""How far a side may lie from the box's: cubes and curvature of the chart, not the sheet's shape."""

BAND_MM: Final = 3.0
"""Depth of the inner band that gives a strip's density."""

EDGE_MM: Final = 1.0
"""How far inside the side the counting starts: well over the noise, and short, so that few points are counted."""

PIXEL_POINTS: Final = 6.0
"""Holes are looked for on pixels that hold this many points on average: two or more nearly always."""

DEGREE: Final = 3
"""Degree of a side's polynomial."""


@dataclass(frozen=True, slots=True)
class Outline:
    """The sides of the sheet on its chart."""

    rotation: Array
    """(2, 2) from the chart to the box: its rows are the box's axes, the longer first."""
    sides: tuple[Array, Array, Array, Array]
    """Left, right, bottom, top: coefficients of the distance as a polynomial of the place along the side / 100 mm."""
    size_mm: tuple[float, float]
    """Mean length and mean width."""

    def to_square(self, uv_mm: Array) -> Array:
        """Return (2, n) places a, b in the unit square of chart points (2, n)."""
        u, v = self.rotation @ uv_mm
        left, right, bottom, top = self.sides
        low_u, low_v = _at(left, v), _at(bottom, u)
        return np.stack([(u - low_u) / (_at(right, v) - low_u), (v - low_v) / (_at(top, u) - low_v)])


def find_outline(uv_mm: Array) -> Outline:
    """Return the four sides of a charted sheet.

    Args:
        uv_mm: (2, n) points on the chart.

    Raises:
        ValueError: A side has too few points.
    """
    rotation = _box_axes(uv_mm)
    box = rotation @ uv_mm
    sides = tuple(_side(box[along], sign * box[across], sign) for across, along, sign in _SIDES)
    at = np.linspace(0.0, 1.0, 21)
    spans = []
    for low, high, along in ((sides[0], sides[1], box[1]), (sides[2], sides[3], box[0])):
        place = along.min() + at * np.ptp(along)
        spans.append(float(np.mean(_at(high, place) - _at(low, place))))
    return Outline(rotation, (sides[0], sides[1], sides[2], sides[3]), (spans[0], spans[1]))


def largest_hole_mm(square: Array, size_mm: tuple[float, float]) -> float:
    """Return the diameter of the largest circle on the sheet with next to no points in it.

    Args:
        square: (2, n) places a, b of the points.
        size_mm: Length and width of the sheet.
    """
    pitch = max(1.0, float(np.sqrt(PIXEL_POINTS * size_mm[0] * size_mm[1] / square.shape[1])))
    shape = (int(np.ceil(size_mm[0] / pitch)), int(np.ceil(size_mm[1] / pitch)))
    cell = [np.clip((place * n).astype(np.intp), 0, n - 1) for place, n in zip(square, shape, strict=True)]
    # One point is no surface: a stray one in the middle of a hole would halve it.
    seen = np.bincount(cell[0] * shape[1] + cell[1], minlength=shape[0] * shape[1]).reshape(shape) > 1
    if seen.all():
        return pitch
    reach = ndimage.distance_transform_edt(~seen, sampling=(size_mm[0] / shape[0], size_mm[1] / shape[1]))
    return float(2.0 * reach.max())  # to the centres of pixels that the rim cuts: about a fifth of a pixel inside it


_SIDES: Final = ((0, 1, -1.0), (0, 1, 1.0), (1, 0, -1.0), (1, 0, 1.0))
"""Left, right, bottom, top: the axis across the side, the axis along it, and which way is out."""


def _at(coefficients: Array, along_mm: Array) -> Array:
    return np.asarray(np.polynomial.polynomial.polyval(along_mm / 100.0, coefficients))


def _box_axes(uv_mm: Array) -> Array:
    """Axes of the box of least area that holds all but stray points; one of its sides lies on the hull."""
    rough = _thin(uv_mm)
    hull = rough[:, ConvexHull(rough.T).vertices]
    edge = np.diff(np.concatenate([hull, hull[:, :1]], axis=1), axis=1)
    angle = np.arctan2(edge[1], edge[0]) % (np.pi / 2)
    angle = np.concatenate([angle, np.linspace(0.0, np.pi / 2, 90, endpoint=False)])
    axes = np.stack(
        [np.stack([np.cos(angle), np.sin(angle)], -1), np.stack([-np.sin(angle), np.cos(angle)], -1)], axis=1
    )
    spans = np.ptp(axes @ hull, axis=2)
    best = int(np.argmin(spans.prod(axis=1)))
    return np.asarray(axes[best] if spans[best, 0] >= spans[best, 1] else np.array([axes[best, 1], -axes[best, 0]]))


def _thin(uv_mm: Array) -> Array:
    """The first and the last 1.5 mm pixel with points in each column: a hull of hundreds, not of all points."""
    low = uv_mm.min(axis=1, keepdims=True)
    cell = ((uv_mm - low) / 1.5).astype(np.intp)
    width = int(cell[1].max()) + 1
    column, row = np.divmod(np.flatnonzero(np.bincount(cell[0] * width + cell[1])), width)
    first = np.flatnonzero(np.diff(column, prepend=-1))
    ends = np.concatenate([first, np.append(first[1:], len(column)) - 1])
    return np.asarray(np.stack([column[ends], row[ends]]) * 1.5 + low)


def _side(along: Array, out: Array, sign: float) -> Array:
    """Polynomial of one side's distance, from the points' density in strips along it."""
    guess = _outermost(out)
    near = out > guess - SEARCH_MM - BAND_MM - EDGE_MM
    along, out = along[near], out[near]
    low, high = float(along.min()), float(along.max())
    per_strip = BAND_MM / (SEARCH_MM + BAND_MM + EDGE_MM) * len(out) * STRIP_MM / (high - low)
    n = max(int((high - low) / STRIP_MM * min(1.0, per_strip / STRIP_POINTS)), 3 * DEGREE)
    strip = np.minimum(((along - low) / (high - low) * n).astype(np.intp), n - 1)
    centre = low + (np.arange(n) + 0.5) * (high - low) / n
    edge = np.full(n, guess)
    for _ in range(3):  # each round counts nearer to the side that the last one found
        start = (edge - EDGE_MM)[strip]
        inner = np.bincount(strip[(out > start - BAND_MM) & (out <= start)], minlength=n)
        beyond = np.bincount(strip[(out > start) & (out <= start + EDGE_MM + SEARCH_MM)], minlength=n)
        filled = inner >= max(3.0, 0.4 * float(np.median(inner)))
        if filled.sum() < 2 * DEGREE:
            raise ValueError(f"a side of the sheet has points in only {filled.sum()} of {n} strips along it")
        measured = edge - EDGE_MM + beyond * BAND_MM / np.maximum(inner, 1)
        good = filled & (beyond > 0)
        design, coefficients = _smooth(centre, measured, good)
        edge = design @ coefficients
    return sign * _about_zero(coefficients, -centre.mean() / 100.0)


def _outermost(out: Array) -> float:
    """Where the points' histogram falls under half of its inner level."""
    bins = np.bincount(((out.max() - out) / 0.5).astype(np.intp))
    level = float(np.median(bins))
    return float(out.max()) - 0.5 * int(np.argmax(bins > 0.5 * level))


def _smooth(centre: Array, measured: Array, good: npt.NDArray[np.bool_]) -> tuple[Array, Array]:
    """Robust polynomial through the strips that saw a side, about their middle: its design matrix and coefficients."""
    design = np.polynomial.polynomial.polyvander((centre - centre.mean()) / 100.0, DEGREE)
    weight = good.astype(np.float64)
    for _ in range(3):
        weighted = design * weight[:, None]
        coefficients = np.linalg.solve(weighted.T @ design, weighted.T @ measured)
        residual = np.abs(measured - design @ coefficients)
        near = residual[good]
        scale = max(1.4826 * float(np.partition(near, len(near) // 2)[len(near) // 2]), 0.02)
        weight = good * np.minimum(1.0, 1.5 * scale / np.maximum(residual, 1e-12)) * (residual < 6.0 * scale)
    return np.asarray(design), np.asarray(coefficients)


def _about_zero(coefficients: Array, shift: float) -> Array:
    """Coefficients of p(x + shift) from those of p(x)."""
    n = len(coefficients)
    powers = [[math.comb(k, j) * shift ** (k - j) if j <= k else 0.0 for k in range(n)] for j in range(n)]
    return np.array(powers) @ coefficients
