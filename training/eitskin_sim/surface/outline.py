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

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull

from eitskin_sim.arrays import Array
from eitskin_sim.surface.edge import DEGREE, Edge, fit_edge

STRIP_MM: Final = 8.0
"""Width of the strips in which a side is looked for at first."""

ROUGH_MM: Final = 25.0
"""How deep under the outermost point a side may lie anywhere along it."""

ROUGH_BIN_MM: Final = 0.25
"""Bins of depth in which points are counted at first."""

ROUGH_DEGREE: Final = 3
"""Degree of the first guess."""

ROUNDS: Final = 2
"""Number of times that the sides are found again between the previous corners."""

MAX_CORNER_DISTANCE_MM: Final = 1e4
"""No corner lies farther from the chart's origin."""

SAME_SIZE_MM: Final = 0.4
"""A grid of points that spans the flat sheet within this is one of the unstretched sheet."""

PIXEL_POINTS: Final = 6.0
"""Holes are looked for on pixels that hold this many points on average: two or more nearly always."""


@dataclass(frozen=True, slots=True)
class Outline:
    """The sides of the sheet on its chart."""

    rotation: Array
    """(2, 2) from the chart to the box: its rows are the box's axes, the longer first."""
    sides: tuple[Array, Array, Array, Array]
    """Left, right, bottom, top: coefficients of the distance as a polynomial of the place along the side / 100 mm."""
    size_mm: tuple[float, float]
    """Mean length and mean width."""
    sigma_mm: float
    """Root mean square of what the sides' places are uncertain by, from place to place."""
    shift_mm: float
    """The same of whole sides: a regular grid shows only roughly where the border is."""

    def without_rim(self, rim_mm: tuple[float, float]) -> "Outline":
        """Return the outline without a rim of this width at both ends of the longer sides, and along them."""
        inwards = np.eye(DEGREE + 1)[0]
        left, right, bottom, top = (
            side - sign * rim_mm[across] * inwards for side, (across, _, sign) in zip(self.sides, _SIDES, strict=True)
        )
        sides = (left, right, bottom, top)
        return replace(self, sides=sides, size_mm=_spans(list(sides)))

    def to_square(self, uv_mm: Array) -> Array:
        """Return (2, n) places a, b in the unit square of chart points (2, n)."""
        u, v = self.rotation @ uv_mm
        left, right, bottom, top = self.sides
        low_u, low_v = _at(left, v), _at(bottom, u)
        return np.stack([(u - low_u) / (_at(right, v) - low_u), (v - low_v) / (_at(top, u) - low_v)])


def find_outline(uv_mm: Array, noise_mm: float, size_mm: tuple[float, float]) -> Outline:
    """Return the four sides of a charted sheet.

    Args:
        uv_mm: (2, n) points on the chart.
        noise_mm: Standard deviation of the points.
        size_mm: The two sides of the flat sheet, the longer first.

    Raises:
        ValueError: A side has too few points.
    """
    rotation = _box_axes(uv_mm)
    box = rotation @ uv_mm
    density = box.shape[1] / float(np.prod(np.ptp(box, axis=1)))
    guess = [sign * _rough_side(box[along], sign * box[across], density) for across, along, sign in _SIDES]
    edges: list[Edge] = []
    for _ in range(ROUNDS):
        corners = _corners(guess)
        edges = []
        for (across, along, sign), side, ends in zip(_SIDES, guess, _ENDS, strict=True):
            span = (float(corners[ends[0]][along]), float(corners[ends[1]][along]))
            edges.append(fit_edge(box[along], sign * box[across], span, sign * side, noise_mm))
        guess = [sign * edge.coefficients for (_, _, sign), edge in zip(_SIDES, edges, strict=True)]
    guess, doubt = _beyond_rows(guess, edges, size_mm)
    sigma, shift = (
        float(np.sqrt(np.mean(np.square(values))))
        for values in ([edge.sigma_mm for edge in edges], [doubt * edge.rows_mm for edge in edges])
    )
    left, right, bottom, top = guess
    return Outline(rotation, (left, right, bottom, top), _spans(guess), sigma, shift)


def _spans(sides: list[Array]) -> tuple[float, float]:
    """Mean length and mean width between four sides."""
    left, right, bottom, top = sides
    corners = _corners(sides)
    at = np.linspace(0.0, 1.0, 21)
    v = corners[0][1] + at * (corners[2][1] - corners[0][1])
    u = corners[0][0] + at * (corners[1][0] - corners[0][0])
    return float(np.mean(_at(right, v) - _at(left, v))), float(np.mean(_at(top, u) - _at(bottom, u)))


def _beyond_rows(sides: list[Array], edges: list[Edge], size_mm: tuple[float, float]) -> tuple[list[Array], float]:
    """Sides moved from the outermost rows of a regular grid to where the border is.

    That is half a row's distance farther out if the points are the middles of cells, and no farther if the grid ends on
    the border. A sheet of the size of the flat one tells; of any other, the middle of the two is taken. Returned
    beside: what the border is uncertain by, in distances of the rows.
    """
    if not any(edge.rows_mm for edge in edges):
        return sides, 0.0

    def moved(part: float) -> list[Array]:
        shift = np.eye(DEGREE + 1)[0]
        return [
            side + sign * part * 0.5 * edge.rows_mm * shift
            for side, edge, (_, _, sign) in zip(sides, edges, _SIDES, strict=True)
        ]

    for part in (0.0, 1.0):
        if np.allclose(_spans(moved(part)), size_mm, rtol=0.0, atol=SAME_SIZE_MM):
            return moved(part), 0.0
    return moved(0.5), 0.25


def _rough_side(along: Array, out: Array, density: float) -> Array:
    """Cubic through the third outermost point of each strip: a stray point or two leave it where it is."""
    near = out > out.max() - ROUGH_MM
    along, out = along[near], out[near]
    low, high = float(along.min()), float(along.max())
    n = max(int((high - low) / STRIP_MM), 3 * ROUGH_DEGREE)
    width = (high - low) / n
    strip = np.minimum(((along - low) / width).astype(np.intp), n - 1)
    bins = int(ROUGH_MM / ROUGH_BIN_MM) + 1
    below = ((out.max() - out) / ROUGH_BIN_MM).astype(np.intp)
    count = np.cumsum(np.bincount(strip * bins + below, minlength=n * bins).reshape(n, bins), axis=1)
    seen = count[:, -1] >= 3
    if seen.sum() < 2 * ROUGH_DEGREE:
        raise ValueError(f"a side of the sheet has points in only {seen.sum()} of {n} strips along it")
    third = np.argmax(count >= 3, axis=1)[seen]
    measured = out.max() - (third + 0.5) * ROUGH_BIN_MM + 2.5 / (density * width)
    centre = np.asarray((low + (np.arange(n) + 0.5) * width)[seen], dtype=np.float64)
    return np.concatenate([_robust(centre / 100.0, measured), np.zeros(DEGREE - ROUGH_DEGREE)])


def _corners(sides: list[Array]) -> list[tuple[float, float]]:
    """(u, v) of left-bottom, right-bottom, left-top and right-top.

    Raises:
        ValueError: Two sides do not meet.
    """
    found = []
    for across in (sides[2], sides[3]):
        for upright in (sides[0], sides[1]):
            u = v = 0.0
            for _ in range(12):  # the sides are nearly at right angles: each round leaves a tenth of the distance
                u, v = float(_at(upright, np.array(v))), float(_at(across, np.array(u)))
                if max(abs(u), abs(v)) > MAX_CORNER_DISTANCE_MM:
                    raise ValueError("two sides do not meet in a corner; expected four sides, nearly at right angles")
            found.append((u, v))
    return found


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


_ENDS: Final = ((0, 2), (1, 3), (0, 1), (2, 3))
"""The corners between which left, right, bottom and top run."""

_SIDES: Final = ((0, 1, -1.0), (0, 1, 1.0), (1, 0, -1.0), (1, 0, 1.0))
"""Left, right, bottom, top: the axis across the side, the axis along it, and which way is out."""


def _at(coefficients: Array, along_mm: Array) -> Array:
    return np.asarray(np.polynomial.polynomial.polyval(along_mm / 100.0, coefficients))


def _box_axes(uv_mm: Array) -> Array:
    """Axes of the box of least area that holds all points; one of its sides lies on their hull."""
    hull = uv_mm[:, ConvexHull(uv_mm.T).vertices]
    edge = np.diff(np.concatenate([hull, hull[:, :1]], axis=1), axis=1)
    angle = np.arctan2(edge[1], edge[0]) % (np.pi / 2)
    angle = np.concatenate([angle, np.linspace(0.0, np.pi / 2, 90, endpoint=False)])
    axes = np.stack(
        [np.stack([np.cos(angle), np.sin(angle)], -1), np.stack([-np.sin(angle), np.cos(angle)], -1)], axis=1
    )
    spans = np.ptp(axes @ hull, axis=2)
    best = int(np.argmin(spans.prod(axis=1)))
    return np.asarray(axes[best] if spans[best, 0] >= spans[best, 1] else np.array([axes[best, 1], -axes[best, 0]]))


def _robust(at: Array, measured: Array) -> Array:
    """Coefficients of the polynomial that most of the values lie on."""
    design = np.polynomial.polynomial.polyvander(at, ROUGH_DEGREE)
    weight = np.ones(len(at))
    for _ in range(6):
        coefficients = np.linalg.lstsq(design * weight[:, None], measured * weight, rcond=None)[0]
        residual = np.abs(measured - design @ coefficients)
        scale = max(1.4826 * float(np.median(residual)), 0.1)
        weight = np.sqrt(np.minimum(1.0, 1.5 * scale / np.maximum(residual, 1e-12)))
    return np.asarray(coefficients)
