"""Touches as the paper's phantoms have them, moved by up to half a pixel, at deformations that nobody chose."""

from dataclasses import replace
from typing import Final

import numpy as np

from eitskin_sim.evaluation import trials
from eitskin_sim.scene.parts import Phantom
from eitskin_sim.scene.scene import load_phantoms
from eitskin_sim.scene.shift import shifted
from eitskin_tools.command_line import files

SHIFT_PX: Final = 0.5
"""A touch on the grid of pixels is easier than it will be."""

SEED: Final = 61_011
"""Names which phantom is taken, and how it is moved."""


def paper_like(deformations: int, each: int) -> list[Phantom]:
    """Return ``each`` phantoms at every deformation of family A."""
    known = load_phantoms(files.find("paper_mm", files.PHANTOMS))
    found = []
    for number, bend in enumerate(trials.deformations_of(deformations, "A")):
        rng = np.random.default_rng([SEED, number])
        for index in range(each):
            one = shifted(known[(number * each + index) % len(known)], SHIFT_PX, rng)
            found.append(replace(one, name=f"A{number}.{index}", scene=replace(one.scene, bend=bend)))
    return found
