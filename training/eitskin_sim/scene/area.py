"""The touched share of each pixel, in closed form: the truth of maps with "area" labels.

For one shape let A(x, y) be its area to the lower left of a point. A pixel's share then takes four values of A::

    pixel (x0, y0, x1, y1):  A(x1, y1) - A(x0, y1) - A(x1, y0) + A(x0, y0)

Along a vertical line the part below y of a shape between bottom(u) and top(u) is min(top, y) - min(bottom, y);
integrated over u < x this is elementary for a circle and for straight sides. Shapes whose boxes overlap are sampled
instead, so that what two of them cover counts once, and a hole in one of them does not.
"""

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.arrays import Array
from eitskin_sim.scene.parts import Touch
from eitskin_sim.scene.shapes import Disc, Ellipse, Polygon, Rect, Shape
from eitskin_sim.scene.touch_table import ELLIPSE, cover

SAMPLES_PER_SIDE: Final = 24
"""Samples a side of a pixel where shapes overlap: a straight border is then off by at most 1/24 of a pixel."""


def area_map(touches: Sequence[Touch], grid: Grid = PAPER.grid, sheet_S_per_m: float | None = None) -> Array:
    """Return the (rows, columns) share of each pixel, 0 to 1, that is covered by at least one touch.

    Args:
        touches: In the order of the scene.
        grid: Whose pixels.
        sheet_S_per_m: Conductivity of the sheet: a touch of the same is a hole in the sharp ones before it; None knows
            no holes.
    """
    # Touches with graded borders come last, as in the forward model.
    ordered = sorted(touches, key=lambda one: one.border_mm > 0.0)
    layers = [(touch, shape) for touch in ordered for shape in touch.shapes]
    shapes = [shape for _, shape in layers]
    holes = [sheet_S_per_m is not None and touch.is_hole(sheet_S_per_m) for touch, _ in layers]
    crowded = [any(_overlap(s, other) for other in shapes if other is not s) for s in shapes]
    found = np.zeros(grid.shape)
    for shape, hole, overlaps in zip(shapes, holes, crowded, strict=True):
        if not (hole or overlaps):
            found += shape_map(shape, grid)
    if any(crowded):
        which = [number for number, overlaps in enumerate(crowded) if overlaps]
        found += _sampled([shapes[one] for one in which], grid, [holes[one] for one in which])
    return np.asarray(np.clip(found, 0.0, 1.0), dtype=np.float64)


def shape_map(shape: Shape, grid: Grid) -> Array:
    """Return the (rows, columns) share of each pixel that one shape covers."""
    x, y = (
        np.arange(n + 1, dtype=np.float64) * np.float64(d) for n, d in zip(grid.shape[::-1], grid.pixel_mm, strict=True)
    )
    match shape:
        case Rect():
            wide = np.diff(np.clip(x, shape.x0_mm, shape.x1_mm))
            high = np.diff(np.clip(y, shape.y0_mm, shape.y1_mm))
            area = high[:, None] * wide
        case Disc():
            area = _cells(_disc_below(x[None, :] - shape.x_mm, y[:, None] - shape.y_mm, shape.radius_mm))
        case Ellipse():
            share = np.zeros(grid.shape)
            piece = (ELLIPSE, shape.x_mm, shape.y_mm, shape.along_mm, shape.across_mm, shape.angle_deg, 1.0)
            rows, columns, own = cover(np.array(piece), x, y)
            share[rows, columns] = own
            area = share * grid.pixel_mm2
        case Polygon():
            area = _cells(_polygon_below(shape.corners_mm, x[None, :], y[:, None]))
    return np.asarray(np.clip(area / grid.pixel_mm2, 0.0, 1.0), dtype=np.float64)


def _cells(below: Array) -> Array:
    return np.diff(np.diff(below, axis=0), axis=1)


def _disc_below(x: Array, y: Array, radius: float) -> Array:
    """Return A(x, y) of a disc about the origin."""

    def half(u: Array) -> Array:  # the integral of sqrt(radius^2 - u^2)
        ratio = np.clip(u / radius, -1.0, 1.0)
        return 0.5 * radius**2 * (ratio * np.sqrt(1.0 - ratio**2) + np.arcsin(ratio))

    x = np.clip(x, -radius, radius)
    y = np.clip(y, -radius, radius)
    reach = np.sqrt(radius**2 - y**2)  # where the line at y leaves the disc
    inner = np.clip(x, -reach, reach)
    across = half(inner) - half(-reach) + y * (inner + reach)
    left = half(np.minimum(x, -reach)) - half(np.full_like(reach, -radius))
    right = half(np.maximum(x, reach)) - half(reach)
    return np.asarray(across + np.where(y > 0.0, 2.0 * (left + right), 0.0))


def _polygon_below(corners: tuple[tuple[float, float], ...], x: Array, y: Array) -> Array:
    """Return A(x, y) of a simple polygon: the sum over its sides of the signed integral of min(side, y)."""
    total = np.zeros(np.broadcast_shapes(x.shape, y.shape))
    turn = 0.0
    for (xa, ya), (xb, yb) in itertools.pairwise((*corners, corners[0])):
        turn += xa * yb - xb * ya
        if xa == xb:
            continue
        (xl, yl), (xr, yr) = ((xa, ya), (xb, yb)) if xa < xb else ((xb, yb), (xa, ya))
        slope = (yr - yl) / (xr - xl)
        end = np.clip(x, xl, xr)
        if slope == 0.0:
            part = (end - xl) * np.minimum(yl, y)
        else:
            crossing = np.clip(xl + (y - yl) / slope, xl, end)
            rise = (crossing - xl) * (yl + slope * (crossing - xl) / 2)
            rest = (end - crossing) * (yl + slope * ((end + crossing) / 2 - xl))
            low_first = rise + (end - crossing) * y
            part = low_first if slope > 0.0 else (crossing - xl) * y + rest
        total += -part if xa < xb else part
    return total if turn > 0.0 else -total


def _overlap(a: Shape, b: Shape) -> bool:
    (ax0, ay0, ax1, ay1), (bx0, by0, bx1, by1) = a.bounds_mm, b.bounds_mm
    rounding = 1e-9
    return min(ax1, bx1) - max(ax0, bx0) > rounding and min(ay1, by1) - max(ay0, by0) > rounding


def _sampled(shapes: Sequence[Shape], grid: Grid, holes: Sequence[bool] | None = None) -> Array:
    """Return the share of each pixel inside shapes, of which each hole takes out what it covers of those before it."""
    rows, columns = grid.shape
    dx, dy = grid.pixel_mm
    offsets = (np.arange(SAMPLES_PER_SIDE) + 0.5) / SAMPLES_PER_SIDE
    x = (np.arange(columns) * dx)[:, None] + offsets * dx
    y = (np.arange(rows) * dy)[:, None] + offsets * dy
    points = np.stack(np.meshgrid(x.ravel(), y.ravel()), axis=-1)
    inside = np.zeros(points.shape[:2], dtype=bool)
    for shape, hole in zip(shapes, holes or [False] * len(shapes), strict=True):
        own = shape.distance_mm(points)[0] <= 0.0
        inside = inside & ~own if hole else inside | own
    return np.asarray(
        inside.reshape(rows, SAMPLES_PER_SIDE, columns, SAMPLES_PER_SIDE).mean(axis=(1, 3)), dtype=np.float64
    )
