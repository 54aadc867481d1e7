"""Moves touches by a random part of a pixel, so that no result depends on the position of the grid.

Touches that meet belong together: the two bars of an L are two rectangles of a scene, and one touch of the sheet. They
move as one. A move that would bring two groups together, or one over the sheet's border, is drawn again.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.parts import Phantom, Touch
from eitskin_sim.scene.shapes import Disc, Ellipse, Polygon, Rect, Shape

MAX_CONTACT_GAP_MM: Final = 1e-6
"""Boxes this near to each other meet."""

TRIES: Final = 1000
"""Draws after which a group that fits nowhere stays where it is."""


def shifted(phantom: Phantom, shift_px: float, rng: np.random.Generator, grid: Grid = PAPER.grid) -> Phantom:
    """Return a phantom whose touches are each moved by a uniform draw from -shift_px to shift_px along x and y.

    Args:
        phantom: With touches anywhere; one on the unit grid cannot move.
        shift_px: Largest move, in pixels; 0 returns the phantom itself.
        rng: Source of the moves.
        grid: Whose pixels.

    Raises:
        ValueError: The phantom's truth is a set of units, or the shift is negative or above a pixel.
    """
    if not 0.0 <= shift_px <= 1.0:
        raise ValueError(f"shift of {shift_px} pixels: it must be from 0 to 1")
    if shift_px == 0.0:
        return phantom
    if phantom.truth != "area":
        raise ValueError(f"phantom {phantom.name} touches units of the grid, which cannot be shifted: give one in mm")
    touches, farthest = list(phantom.scene.touches), shift_px * np.array(grid.pixel_mm)
    length, width = phantom.scene.sheet.size_mm
    groups = _groups(touches)
    for group in groups:
        others = [touches[i] for other in groups if other is not group for i in other]
        for _ in range(TRIES):
            x, y = rng.uniform(-farthest, farthest)
            moved = [_moved(touches[i], float(x), float(y)) for i in group]
            boxes = [shape.bounds_mm for touch in moved for shape in touch.shapes]
            inside = all(b[0] >= 0.0 and b[1] >= 0.0 and b[2] <= length and b[3] <= width for b in boxes)
            if inside and not any(_meet(mine, other) for mine in moved for other in others):
                for i, touch in zip(group, moved, strict=True):
                    touches[i] = touch
                break
    return replace(phantom, scene=replace(phantom.scene, touches=tuple(touches)))


def _groups(touches: list[Touch]) -> list[list[int]]:
    """Numbers of the touches that hang together by their boxes."""
    groups: list[list[int]] = []
    for number, touch in enumerate(touches):
        joined = [group for group in groups if any(_meet(touch, touches[i]) for i in group)]
        groups = [group for group in groups if group not in joined]
        groups.append(sorted([number, *(i for group in joined for i in group)]))
    return groups


def _meet(first: Touch, second: Touch) -> bool:
    for a in (shape.bounds_mm for shape in first.shapes):
        for b in (shape.bounds_mm for shape in second.shapes):
            if (
                max(a[0], b[0]) <= min(a[2], b[2]) + MAX_CONTACT_GAP_MM
                and max(a[1], b[1]) <= min(a[3], b[3]) + MAX_CONTACT_GAP_MM
            ):
                return True
    return False


def _moved(touch: Touch, x_mm: float, y_mm: float) -> Touch:
    return replace(touch, shapes=tuple(_moved_shape(shape, x_mm, y_mm) for shape in touch.shapes))


def _moved_shape(shape: Shape, x_mm: float, y_mm: float) -> Shape:
    match shape:
        case Rect(x0, y0, x1, y1):
            return Rect(x0 + x_mm, y0 + y_mm, x1 + x_mm, y1 + y_mm)
        case Disc(x, y, radius):
            return Disc(x + x_mm, y + y_mm, radius)
        case Ellipse():
            return replace(shape, x_mm=shape.x_mm + x_mm, y_mm=shape.y_mm + y_mm)
        case Polygon(corners):
            return Polygon(tuple((x + x_mm, y + y_mm) for x, y in corners))
