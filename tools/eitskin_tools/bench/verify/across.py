"""A touch that lies across the sheet's sides: a finger laid on it, turned by any angle."""

from typing import Final

import numpy as np

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation import trials
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Phantom, Touch
from eitskin_sim.scene.shapes import Ellipse

SEED: Final = 61_017
"""Names where touches lie, how large they are, and how they are turned."""

LONG_MM: Final = (28.0, 42.0)
WIDE_MM: Final = (12.0, 16.0)
"""Axes, from and to."""

MARGIN_MM: Final = 3.0
"""To the sheet's border."""


def across(contrast: float, border_mm: float, deformations: int, each: int) -> list[Phantom]:
    """Return ``each`` ellipses, one a map, at every deformation of family A.

    Args:
        contrast: Of each.
        border_mm: Width of its graded border; 0 is sharp.
        deformations: How many deformations.
        each: Maps at each.
    """
    found, size = [], np.array(PAPER.grid.size_mm)
    for number, bend in enumerate(trials.deformations_of(deformations, "A")):
        rng = np.random.default_rng([SEED, number])
        for index in range(each):
            along, wide, angle = rng.uniform(*LONG_MM), rng.uniform(*WIDE_MM), rng.uniform(0.0, 180.0)
            reach = (along + border_mm) / 2.0 + MARGIN_MM
            x, y = rng.uniform(reach, size - reach)
            touch = Touch((Ellipse(x, y, along, wide, angle),), contrast=contrast, border_mm=border_mm)
            found.append(Phantom(f"A{number}.{index}", nominal_scene(PAPER, bend, (touch,)), "area"))
    return found
