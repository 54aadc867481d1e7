"""Finds objects in a tank: the heights and depths of an image of the disc, seen as a finger's width sees it.

Cells of the square have very different areas in the disc. What a neighbourhood changes in all, the sum of x dA under a
Gaussian of a tenth of the radius, does not depend on how it is divided. Its largest magnitude is an object, of its
sign; so is each next one that is at least half as strong, and not on the flank of one that was found before.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.arrays import Array
from eitskin_sim.tank.disc import EVEN_DEG
from eitskin_sim.tank.model import TankModel
from eitskin_sim.tank.recording import Material, Object, Unknown

MIN_SEPARATION_RADII: Final = 1.0 / 3.0
"""So near to an object, in radii, is no other one."""

MIN_PEAK_SHARE: Final = 0.5
"""Of the strongest."""

MAX_OBJECTS: Final = N_ELECTRODES

SECTOR_DEG: Final = 360.0 / N_ELECTRODES


@dataclass(frozen=True, slots=True)
class ImageObject:
    """An object that an image shows."""

    angle_deg: float
    """Counter-clockwise, 0 at electrode 1."""
    radius: float
    """Of the tank's."""
    material: Material
    """metal where it conducts better than water, else plastic."""
    strength: float
    """Of the strongest."""


@dataclass(frozen=True, slots=True)
class JudgedObject:
    """An object that stands in the tank, and what was found of it."""

    object: Object
    found: ImageObject | None
    """The nearest of its sign; None where there is none."""
    error_deg: float | None

    @property
    def right(self) -> bool:
        """Whether it was found in its own sector, with its own sign."""
        return self.error_deg is not None and self.error_deg <= SECTOR_DEG / 2


def find_objects(model: TankModel, image: Array) -> list[ImageObject]:
    """Return the objects that an image of (n,) cells shows, the strongest first; none if it is empty."""
    image = model.neighbourhoods @ image
    left, found = np.abs(image), list[ImageObject]()
    largest = float(left.max())
    while len(found) < MAX_OBJECTS:
        at = int(np.argmax(left))
        if not left[at] > 0.0 or left[at] < MIN_PEAK_SHARE * largest:
            break
        x, y = model.places[at]
        angle = float(np.remainder(np.rad2deg(np.arctan2(y, x)) - EVEN_DEG[0], 360.0))
        material: Material = "metal" if image[at] > 0.0 else "plastic"
        found.append(ImageObject(angle, float(np.hypot(x, y)), material, float(left[at]) / largest))
        left[np.hypot(*(model.places - model.places[at]).T) < MIN_SEPARATION_RADII] = 0.0
    return found


def judge(objects: Sequence[Object], found: Sequence[ImageObject]) -> list[JudgedObject]:
    """Return the result for every object: each found one counts once, for the object that it is nearest to."""
    pairs = sorted(
        (angle_error_deg(one, other), i, j)
        for i, one in enumerate(objects)
        for j, other in enumerate(found)
        if one.material == other.material
    )
    taken: dict[int, tuple[int, float]] = {}
    for error, i, j in pairs:
        if i not in taken and j not in {number for number, _ in taken.values()}:
            taken[i] = j, error
    return [
        JudgedObject(one, found[taken[i][0]], taken[i][1]) if i in taken else JudgedObject(one, None, None)
        for i, one in enumerate(objects)
    ]


def ghosts(judged: Sequence[JudgedObject], found: Sequence[ImageObject], unknown: Sequence[Unknown]) -> int:
    """Return how many found ones are no object's: not the right ones, nor in the sector of an object of any sign."""
    right = [one.found for one in judged if one.right]
    return sum(
        one not in right and all(angle_error_deg(other, one) > SECTOR_DEG / 2 for other in unknown) for one in found
    )


def angle_error_deg(one: Object | Unknown, other: ImageObject) -> float:
    """Return how far a found object is from the middle of an object's electrode, from 0 to 180."""
    apart = other.angle_deg - SECTOR_DEG * (one.electrode - 1)
    return abs(float(np.remainder(apart + 180.0, 360.0)) - 180.0)
