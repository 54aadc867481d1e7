"""The touched share of each pixel: the truth of maps with "area" labels.

Shapes that stand alone are measured as those of a table are (:func:`eitskin_sim.scene.touch_table.cover`): exactly
along y, and where their outline is not parallel to x in strips along it. Shapes whose boxes overlap are sampled
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
from eitskin_sim.scene.shapes import Ellipse, Polygon, Rect, Shape
from eitskin_sim.scene.touch_table import DISC, ELLIPSE, RECTANGLE, STRIPS, cover, pixel_lines, strips_of

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
    lines = pixel_lines(grid)
    if isinstance(shape, Polygon):
        return _polygon_map(np.array(shape.corners_mm), *lines)
    x0, y0, x1, y1 = shape.bounds_mm
    sides, angle, kind = (x1 - x0, y1 - y0), 0.0, RECTANGLE if isinstance(shape, Rect) else DISC
    if isinstance(shape, Ellipse):
        sides, angle, kind = (shape.along_mm, shape.across_mm), shape.angle_deg, ELLIPSE
    found = np.zeros(grid.shape)
    rows, columns, share = cover(np.array([kind, (x0 + x1) / 2, (y0 + y1) / 2, *sides, angle, 1.0]), *lines)
    found[rows, columns] = share
    return found


def _polygon_map(corners: Array, x_lines: Array, y_lines: Array) -> Array:
    """Return the shares of a simple polygon: along a strip, what lies below y is the signed sum of min(side, y)."""
    x = strips_of(x_lines)
    below = np.zeros((len(y_lines), len(x)))
    for (xa, ya), (xb, yb) in itertools.pairwise((*corners, corners[0])):
        crossed = np.flatnonzero((x > min(xa, xb)) & (x < max(xa, xb)))
        side = ya + (x[crossed] - xa) * (yb - ya) / (xb - xa) if len(crossed) else 0.0
        below[:, crossed] += np.sign(xb - xa) * np.minimum(side, y_lines[:, None])
    share = np.abs(np.diff(below, axis=0)).reshape(len(y_lines) - 1, len(x_lines) - 1, STRIPS).mean(axis=2)
    return np.asarray(share / np.diff(y_lines)[:, None])


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
