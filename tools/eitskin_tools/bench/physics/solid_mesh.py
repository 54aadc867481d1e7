"""The lines of the solid's mesh: through every contact's and touch's edges, in geometric steps from each.

Near a contact's edge the current turns into the layer within the sheet's thickness and crowds over z sigma, 0.1 mm; so
the elements grow from there in all three directions. Two meshes of which one has everything half as large say how far
the finer one still is from the limit: :func:`extrapolated`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.scene.parts import Scene, Touch

Array = npt.NDArray[np.float64]
Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Resolution:
    """How fine the solid's mesh is, in mm."""

    contact_mm: float = 0.4
    """Beside a contact's edge, along the sheet and in depth."""
    touch_mm: float = 1.0
    largest_mm: float = 6.0
    growth: float = 2.0
    """Ratio of neighbouring elements."""

    def halved(self) -> "Resolution":
        """Return the mesh of half the elements' sizes, and of the same grading."""
        return Resolution(self.contact_mm / 2, self.touch_mm / 2, self.largest_mm / 2, float(np.sqrt(self.growth)))


def solid_lines(
    scene: Scene, boxes: Sequence[Box], touches: Sequence[Touch], fine: Resolution
) -> tuple[Array, Array, Array]:
    """Return the lines along x, y and z; z rises to the face with the contacts."""
    touched = [shape.bounds_mm for touch in touches for shape in touch.shapes]
    found = []
    for axis in (0, 1):
        marks = {0.0: fine.touch_mm, scene.sheet.size_mm[axis]: fine.touch_mm}
        for corners, size in ((touched, fine.touch_mm), (boxes, fine.contact_mm)):
            for corner in corners:
                marks[round(corner[axis], 9)] = marks[round(corner[axis + 2], 9)] = size
        edges = np.array([box[i] for box in boxes for i in (axis, axis + 2)])
        for at in marks:  # a touch's border under or beside a contact is as sharp as the contact's own edge
            if np.abs(edges - at).min() < scene.sheet.thickness_mm:
                marks[at] = fine.contact_mm
        found.append(geometric(sorted(marks.items()), fine.largest_mm, fine.growth))
    thickness = scene.sheet.thickness_mm
    return found[0], found[1], geometric([(0.0, thickness), (thickness, fine.contact_mm)], thickness, fine.growth)


def geometric(marks: Sequence[tuple[float, float]], largest: float, growth: float) -> Array:
    """Return lines through all marks (place, size there): equal steps of a size that grows linearly from both ends."""
    slope = np.log(growth)
    lines = [np.array([marks[0][0]])]
    for (a, from_a), (b, from_b) in pairwise(marks):
        at = np.linspace(a, b, 2001)
        size = np.minimum(np.minimum(from_a + slope * (at - a), from_b + slope * (b - at)), largest)
        steps = np.concatenate([[0.0], np.cumsum(0.5 * (1 / size[1:] + 1 / size[:-1]) * np.diff(at))])
        count = max(1, round(float(steps[-1])))
        lines.append(np.interp(np.arange(1, count + 1) * steps[-1] / count, steps, at))
        lines[-1][-1] = b
    return np.concatenate(lines)


ORDER: Final = 2.0
"""Of the voltages' error with all elements halved: a contact's edge holds biquadratic elements to this (measured)."""


def extrapolated(coarse: Array, fine: Array) -> tuple[Array, Array]:
    """Return Richardson's limit of two solutions, and how far the finer one is from it."""
    gain = (fine - coarse) / (2.0**ORDER - 1.0)
    return fine + gain, np.abs(gain)
