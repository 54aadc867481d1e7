"""A touch that slides over the bent sheet, frame after frame: what following it saves."""

from typing import Final

import numpy as np

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation import trials
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Phantom, Touch
from eitskin_sim.scene.shapes import Rect

SEED: Final = 61_013
"""Names where touches begin, and which way they go."""

SIDE_MM: Final = 10.0
"""Of each touch."""

STEP_MM: Final = 3.0
"""From frame to frame: 150 mm/s at 50 frames a second."""

APART_MM: Final = 35.0
"""Between the middles of touches that move side by side."""

MARGIN_MM: Final = 4.0
"""Touches turn back before the border."""


def sliding(touches: int, deformations: int, each: int) -> list[Phantom]:
    """Return ``each`` frames of one path at every deformation of family A.

    Args:
        touches: How many move side by side.
        deformations: How many deformations.
        each: Frames at each.
    """
    found = []
    for number, bend in enumerate(trials.deformations_of(deformations, "A")):
        rng = np.random.default_rng([SEED, number])
        room = np.array(PAPER.grid.size_mm) - 2.0 * MARGIN_MM - SIDE_MM - np.array([(touches - 1) * APART_MM, 0.0])
        at = rng.uniform(0.0, room)
        turn = rng.uniform(0.0, 2.0 * np.pi)
        step = STEP_MM * np.array([np.cos(turn), np.sin(turn)])
        for index in range(each):
            folded = np.abs((at + index * step) % (2.0 * room))  # it turns back at the border
            corner = MARGIN_MM + np.where(folded > room, 2.0 * room - folded, folded)
            rects = [_square(corner[0] + k * APART_MM, corner[1]) for k in range(touches)]
            scene = nominal_scene(PAPER, bend, tuple(rects))
            found.append(Phantom(f"A{number}.{index}", scene, "area"))
    return found


def _square(x_mm: float, y_mm: float) -> Touch:
    return Touch((Rect(float(x_mm), float(y_mm), float(x_mm) + SIDE_MM, float(y_mm) + SIDE_MM),))
