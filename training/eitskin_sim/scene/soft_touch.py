"""Soft touches: contrast, graded border and dent.

::

    contrast     conductivity inside over the sheet's, below 1 where pressing lowers it
    border_mm    log conductivity runs linearly over this width about the outline
    dent_mm      depth; the sheet is pressed in along its normal by dent * Phi(-d / 4 mm), d the distance outside

A scene whose touch would change nothing, or cannot be represented, is an error and not an untouched sheet. A sharp
touch of contrast 1 over an earlier sharp one is a hole in that: the later holds.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from scipy.special import ndtr

from eitskin_proto.fields import Fields
from eitskin_sim.arrays import Array
from eitskin_sim.scene.parts import MIN_LOG_CONTRAST, Scene, SceneError, Sheet, Touch
from eitskin_sim.scene.shapes import Disc, Ellipse, Polygon, Rect, Shape

MIN_BORDER_MM: Final = 0.5
"""The narrowest graded border that a mesh represents; below it a border is sharp."""

DENT_WALL_MM: Final = 4.0
"""Sigma of a dent's wall."""

DEEPEST_MM: Final = 10.0
"""The deepest dent: its wall is then as steep as 45 degrees."""

OVERLAP_POINTS: Final = 64
"""Points a side of the box in which it is looked whether two shapes overlap."""


def soft_fields(fields: Fields, shapes: int) -> dict[str, Any]:
    """Return ``contrast``, ``border_mm`` and ``dent_mm`` of a touch's JSON.

    Args:
        fields: The touch's keys.
        shapes: How many shapes it has; only one alone may have a graded border or a dent.

    Raises:
        SceneError: A value is outside its bounds, or two say what the conductivity is.
    """
    contrast: float | None = None
    if "contrast" in fields:
        if "conductivity_S_per_m" in fields:
            raise SceneError(f"{fields.where}: found contrast and conductivity_S_per_m; give one of them")
        contrast = fields.number("contrast", low=1e-9, high=1e9)
    border = fields.number("border_mm", 0.0, low=0.0)
    dent = fields.number("dent_mm", 0.0, low=0.0, high=DEEPEST_MM)
    if shapes != 1 and (border or dent):
        raise SceneError(
            f"{fields.where}.units have sharp borders and no dent; found border_mm {border:g} and dent_mm {dent:g}: "
            "give the touch as rect_mm, disc_mm, ellipse_mm or polygon_mm"
        )
    return {"contrast": contrast, "border_mm": border, "dent_mm": dent}


def check_touch(touch: Touch, sheet: Sheet, where: str, earlier: Sequence[Touch] = ()) -> None:
    """Raise SceneError if a touch would change nothing, or has a border that cannot be represented.

    Args:
        touch: The touch.
        sheet: What it touches.
        where: Its path, for messages.
        earlier: The touches before it.
    """
    factor = touch.factor(sheet.conductivity_S_per_m)
    alike = touch.is_alike(sheet.conductivity_S_per_m)
    if alike and not touch.dent_mm and not _takes_out(touch, sheet, earlier):
        raise SceneError(
            f"{where} changes nothing: its contrast is {factor:.6g}; it must be below or above 1 by at least "
            f"{MIN_LOG_CONTRAST:g}, have a dent_mm, or be a hole: both sharp, over an earlier touch"
        )
    if 0.0 < touch.border_mm < MIN_BORDER_MM:
        raise SceneError(
            f"{where}.border_mm is {touch.border_mm:g}; it must be 0, a sharp border, or at least {MIN_BORDER_MM:g}"
        )
    width = min(shape.width_mm for shape in touch.shapes)
    if touch.border_mm > width:
        raise SceneError(
            f"{where}.border_mm is {touch.border_mm:g}; it must be at most the touch's width, {width:.4g}: a wider one "
            "has no middle of full contrast"
        )


def _takes_out(touch: Touch, sheet: Sheet, earlier: Sequence[Touch]) -> bool:
    """Return whether a touch is a hole in one of those before it; graded ones come last and are not covered."""
    below = [other for other in earlier if not other.border_mm]
    return touch.is_hole(sheet.conductivity_S_per_m) and any(
        _overlap(shape, other) for shape in touch.shapes for one in below for other in one.shapes
    )


def _overlap(one: Shape, other: Shape) -> bool:
    """Return whether two shapes have a place in common, looked at point by point."""
    (ax0, ay0, ax1, ay1), (bx0, by0, bx1, by1) = one.bounds_mm, other.bounds_mm
    x0, y0, x1, y1 = max(ax0, bx0), max(ay0, by0), min(ax1, bx1), min(ay1, by1)
    if x1 <= x0 or y1 <= y0:
        return False
    step = (np.arange(OVERLAP_POINTS) + 0.5) / OVERLAP_POINTS
    points = np.stack(np.meshgrid(x0 + (x1 - x0) * step, y0 + (y1 - y0) * step), axis=-1)
    return bool(np.any((one.distance_mm(points)[0] < 0.0) & (other.distance_mm(points)[0] < 0.0)))


def check_touches(scene: Scene) -> None:
    """Raise SceneError if a touch of a scene changes nothing: no contrast, no place on the sheet, no such border."""
    length, width = scene.sheet.size_mm
    for index, touch in enumerate(scene.touches):
        where = f"scene.touches[{index}]"
        check_touch(touch, scene.sheet, where, scene.touches[:index])
        for shape in touch.shapes:
            x0, y0, x1, y1 = shape.bounds_mm
            if x0 >= length or y0 >= width or x1 <= 0.0 or y1 <= 0.0:
                raise SceneError(
                    f"{where} lies outside the sheet: it goes from ({x0:g}, {y0:g}) to ({x1:g}, {y1:g}) mm; the sheet "
                    f"from (0, 0) to ({length:g}, {width:g})"
                )


def soft_json(touch: Touch) -> dict[str, Any]:
    """Return the keys of a touch's JSON apart from its shape."""
    found: dict[str, Any] = (
        {"conductivity_S_per_m": touch.conductivity_S_per_m} if touch.contrast is None else {"contrast": touch.contrast}
    )
    found.update({name: getattr(touch, name) for name in ("border_mm", "dent_mm") if getattr(touch, name)})
    return found


def shape_json(shape: Shape) -> tuple[str, Any]:
    """Return the key and the value of a shape in JSON."""
    match shape:
        case Rect():
            return "rect_mm", list(shape.bounds_mm)
        case Disc():
            return "disc_mm", [shape.x_mm, shape.y_mm, shape.radius_mm]
        case Ellipse():
            return "ellipse_mm", [shape.x_mm, shape.y_mm, shape.along_mm, shape.across_mm, shape.angle_deg]
        case Polygon():
            return "polygon_mm", [list(corner) for corner in shape.corners_mm]


def dents_of(touches: Sequence[Touch]) -> tuple[Touch, ...]:
    """Return the touches that press the sheet in."""
    return tuple(touch for touch in touches if touch.dent_mm)


def dent_heights(dents: Sequence[Touch], xy_mm: Array) -> tuple[Array, Array]:
    """Return how far dents press the surface in, along its normal: heights (n,) mm and their gradients (n, 2)."""
    height, slope = np.zeros(len(xy_mm)), np.zeros((len(xy_mm), 2))
    for dent in dents:
        for shape in dent.shapes:
            distance, normal = shape.distance_mm(xy_mm)
            wall = distance / DENT_WALL_MM
            height += dent.dent_mm * ndtr(-wall)
            steep = dent.dent_mm / DENT_WALL_MM / np.sqrt(2.0 * np.pi) * np.exp(-0.5 * wall**2)
            slope -= steep[:, None] * normal
    return height, slope
