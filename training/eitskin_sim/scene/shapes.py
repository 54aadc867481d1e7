"""Outlines of touches on the flat sheet, each a signed distance: negative inside, in mm.

A signed distance serves every purpose at once: whether a point is touched, how much of a cell a straight border leaves
inside, and in which direction that border faces (the distance's gradient). All functions take any number of points.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_sim.arrays import Array


@dataclass(frozen=True, slots=True)
class Rect:
    """An axis-aligned rectangle."""

    x0_mm: float
    y0_mm: float
    x1_mm: float
    y1_mm: float

    @property
    def bounds_mm(self) -> tuple[float, float, float, float]:
        """The box (x0, y0, x1, y1) that holds the shape."""
        return self.x0_mm, self.y0_mm, self.x1_mm, self.y1_mm

    @property
    def area_mm2(self) -> float:
        """The area inside."""
        return (self.x1_mm - self.x0_mm) * (self.y1_mm - self.y0_mm)

    @property
    def width_mm(self) -> float:
        """The narrowest extent."""
        return min(self.x1_mm - self.x0_mm, self.y1_mm - self.y0_mm)

    def distance_mm(self, xy_mm: Array) -> tuple[Array, Array]:
        """Return signed distances (...,) and outward unit normals (..., 2) of points (..., 2)."""
        centre = np.array([(self.x0_mm + self.x1_mm) / 2, (self.y0_mm + self.y1_mm) / 2])
        half = np.array([(self.x1_mm - self.x0_mm) / 2, (self.y1_mm - self.y0_mm) / 2])
        offset = np.asarray(xy_mm) - centre
        beyond = np.abs(offset) - half
        outside = np.maximum(beyond, 0.0)
        length = np.hypot(outside[..., 0], outside[..., 1])
        distance = length + np.minimum(beyond.max(axis=-1), 0.0)
        along_x = beyond[..., 0] >= beyond[..., 1]
        inner = np.stack([along_x, ~along_x], axis=-1).astype(np.float64)
        safe = np.where(length > 0.0, length, 1.0)[..., None]
        direction = np.where((length > 0.0)[..., None], outside / safe, inner)
        return distance, direction * np.where(offset < 0.0, -1.0, 1.0)


@dataclass(frozen=True, slots=True)
class Disc:
    """A disc."""

    x_mm: float
    y_mm: float
    radius_mm: float

    @property
    def bounds_mm(self) -> tuple[float, float, float, float]:
        """The box (x0, y0, x1, y1) that holds the shape."""
        r = self.radius_mm
        return self.x_mm - r, self.y_mm - r, self.x_mm + r, self.y_mm + r

    @property
    def area_mm2(self) -> float:
        """The area inside."""
        return float(np.pi * self.radius_mm**2)

    @property
    def width_mm(self) -> float:
        """The diameter."""
        return 2.0 * self.radius_mm

    def distance_mm(self, xy_mm: Array) -> tuple[Array, Array]:
        """Return signed distances (...,) and outward unit normals (..., 2) of points (..., 2)."""
        offset = np.asarray(xy_mm) - np.array([self.x_mm, self.y_mm])
        length = np.hypot(offset[..., 0], offset[..., 1])
        normal = offset / np.where(length > 0.0, length, 1.0)[..., None]
        normal[..., 0] = np.where(length > 0.0, normal[..., 0], 1.0)
        return length - self.radius_mm, normal


@dataclass(frozen=True, slots=True)
class Ellipse:
    """An ellipse of two axes; the first lies at ``angle_deg`` from x."""

    x_mm: float
    y_mm: float
    along_mm: float
    across_mm: float
    """The axes' full lengths, either may be the longer."""
    angle_deg: float = 0.0

    @property
    def bounds_mm(self) -> tuple[float, float, float, float]:
        """The box (x0, y0, x1, y1) that holds the shape."""
        turn = np.deg2rad(self.angle_deg)
        half_x = float(np.hypot(self.along_mm * np.cos(turn), self.across_mm * np.sin(turn))) / 2
        half_y = float(np.hypot(self.along_mm * np.sin(turn), self.across_mm * np.cos(turn))) / 2
        return self.x_mm - half_x, self.y_mm - half_y, self.x_mm + half_x, self.y_mm + half_y

    @property
    def area_mm2(self) -> float:
        """The area inside."""
        return float(np.pi) / 4 * self.along_mm * self.across_mm

    @property
    def width_mm(self) -> float:
        """The shorter axis."""
        return min(self.along_mm, self.across_mm)

    def distance_mm(self, xy_mm: Array) -> tuple[Array, Array]:
        """Return signed distances (...,) and outward unit normals (..., 2) of points (..., 2)."""
        turn = np.deg2rad(self.angle_deg)
        cos, sin = np.cos(turn), np.sin(turn)
        offset = np.asarray(xy_mm) - np.array([self.x_mm, self.y_mm])
        local = np.stack([offset @ [cos, sin], offset @ [-sin, cos]], axis=-1)
        distance, normal = ellipse_distance(local, np.array([self.along_mm, self.across_mm]) / 2)
        return distance, np.stack([normal @ [cos, -sin], normal @ [sin, cos]], axis=-1)


NEAREST_POINT_STEPS: Final = 4
"""Steps to the nearest point of an ellipse, each by its circle of curvature: within 0.01 mm at axes of 1 to 3."""


def ellipse_distance(local_mm: Array, half_mm: Array) -> tuple[Array, Array]:
    """Return signed distances (...,) and outward unit normals (..., 2) of points from upright ellipses.

    Args:
        local_mm: (..., 2) points, from the middle, along the axes.
        half_mm: (..., 2) half axes.
    """
    a, b = half_mm[..., 0], half_mm[..., 1]
    x, y = np.abs(local_mm[..., 0]), np.abs(local_mm[..., 1])
    t_x, t_y = np.full(x.shape, np.sqrt(0.5)), np.full(x.shape, np.sqrt(0.5))
    middle_x, middle_y = (a * a - b * b) / a, (b * b - a * a) / b
    for _ in range(NEAREST_POINT_STEPS):
        # The circle that fits the ellipse best at (a t_x, b t_y) has its middle at e; the point's nearest on the circle
        # is nearly that on the ellipse. Products and roots: numpy's powers and hypot take three to ten times as long.
        e_x, e_y = middle_x * (t_x * t_x * t_x), middle_y * (t_y * t_y * t_y)
        radius = length_of(a * t_x - e_x, b * t_y - e_y)
        q_x, q_y = x - e_x, y - e_y
        reach = radius / np.maximum(length_of(q_x, q_y), 1e-12)
        t_x = np.clip((q_x * reach + e_x) / a, 0.0, 1.0)
        t_y = np.clip((q_y * reach + e_y) / b, 0.0, 1.0)
        length = np.maximum(length_of(t_x, t_y), 1e-12)
        t_x, t_y = t_x / length, t_y / length
    inside = (x / a) ** 2 + (y / b) ** 2 <= 1.0
    distance = length_of(x - a * t_x, y - b * t_y) * np.where(inside, -1.0, 1.0)
    n_x, n_y = t_x / a, t_y / b
    length = np.maximum(length_of(n_x, n_y), 1e-12)
    sign = np.where(np.asarray(local_mm) < 0.0, -1.0, 1.0)
    return distance, np.stack([n_x / length, n_y / length], axis=-1) * sign


def length_of(x: Array, y: Array) -> Array:
    """Return the lengths of vectors, of any shape: a root takes a fifth of numpy's hypot, which no mm need."""
    return np.asarray(np.sqrt(x * x + y * y))


@dataclass(frozen=True, slots=True)
class Polygon:
    """A simple polygon; either orientation, not closed by repeating the first corner."""

    corners_mm: tuple[tuple[float, float], ...]

    @property
    def bounds_mm(self) -> tuple[float, float, float, float]:
        """The box (x0, y0, x1, y1) that holds the shape."""
        x, y = zip(*self.corners_mm, strict=True)
        return min(x), min(y), max(x), max(y)

    @property
    def area_mm2(self) -> float:
        """The area inside."""
        return abs(_shoelace(np.array(self.corners_mm)))

    @property
    def width_mm(self) -> float:
        """Twice the area over half the perimeter, or the smaller side of the bounding box: at most its thinness."""
        corners = np.array(self.corners_mm)
        sides = np.roll(corners, -1, axis=0) - corners
        perimeter = float(np.hypot(sides[:, 0], sides[:, 1]).sum())
        x0, y0, x1, y1 = self.bounds_mm
        return min(4.0 * self.area_mm2 / perimeter, x1 - x0, y1 - y0)

    @property
    def is_simple(self) -> bool:
        """Whether sides meet only at their common corners: none cross, touch, or double back."""
        corners = np.array(self.corners_mm)
        ends = np.roll(corners, -1, axis=0)
        count = len(corners)
        for i in range(count):
            following = ends[(i + 1) % count]
            if _turn(corners[i], ends[i], following) == 0.0 and (ends[i] - corners[i]) @ (following - ends[i]) < 0.0:
                return False
            for j in range(i + 2, count):
                if (j + 1) % count != i and _meet(corners[i], ends[i], corners[j], ends[j]):
                    return False
        return True

    def distance_mm(self, xy_mm: Array) -> tuple[Array, Array]:
        """Return signed distances (...,) and outward unit normals (..., 2) of points (..., 2)."""
        points = np.asarray(xy_mm)
        corners = np.array(self.corners_mm)
        ends = np.roll(corners, -1, axis=0)
        squared = np.full(points.shape[:-1], np.inf)
        nearest = np.zeros(points.shape)
        side_normal = np.zeros(points.shape)
        inside = np.zeros(points.shape[:-1], dtype=bool)
        turn = np.sign(_shoelace(corners))
        for a, b in zip(corners, ends, strict=True):
            side = b - a
            relative = points - a
            along = np.clip(relative @ side / (side @ side), 0.0, 1.0)
            gap = relative - along[..., None] * side
            here = np.einsum("...i,...i", gap, gap)
            closer = here < squared
            squared = np.where(closer, here, squared)
            nearest = np.where(closer[..., None], gap, nearest)
            outward = turn * np.array([side[1], -side[0]]) / np.hypot(*side)
            side_normal = np.where(closer[..., None], outward, side_normal)
            straddles = (a[1] > points[..., 1]) != (b[1] > points[..., 1])
            rise = side[1] if side[1] != 0.0 else 1.0
            inside ^= straddles & (points[..., 0] < a[0] + (points[..., 1] - a[1]) * side[0] / rise)
        length = np.sqrt(squared)
        sign = np.where(inside, -1.0, 1.0)
        clear = length > 1e-9
        outward = sign[..., None] * nearest / np.where(clear, length, 1.0)[..., None]
        normal = np.where(clear[..., None], outward, side_normal)
        return sign * length, normal


Shape = Rect | Disc | Ellipse | Polygon


def _shoelace(corners: Array) -> float:
    x, y = corners[:, 0], corners[:, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _meet(a: Array, b: Array, c: Array, d: Array) -> bool:
    """Return whether two segments have a point in common."""
    one, other = _turn(a, b, c) * _turn(a, b, d), _turn(c, d, a) * _turn(c, d, b)
    if one < 0.0 and other < 0.0:
        return True
    return any(_on(p, q, r) for p, q, r in ((a, b, c), (a, b, d), (c, d, a), (c, d, b)))


def _on(a: Array, b: Array, c: Array) -> bool:
    """Return whether c lies on the segment from a to b."""
    return _turn(a, b, c) == 0.0 and bool(np.all((np.minimum(a, b) <= c) & (c <= np.maximum(a, b))))
