"""Shapes that are one touch, as an L is two rectangles: no crack runs between them, and one body has one contrast.

A crack of a millimetre, or two contrasts, answer nearly as the body does: without a cost for them, arms of an L grow
and shrink against each other. Shapes that overlap cost nothing.
"""

from typing import Final

import numpy as np

from eitskin_sim.scene.touch_table import Array
from eitskin_sim.shapes.parameters import HALF_LENGTH, LOG_CONTRAST, X

CRACK_SD_MM: Final = 0.3
"""Of a crack's width: next to none."""

ALIKE_SD: Final = 0.05
"""Of the difference of two shapes' log contrasts."""

Joints = tuple[tuple[int, int], ...]
"""Numbers of upright rectangles that hang together, in pairs."""


def bodies(count: int, joints: Joints) -> int:
    """Return how many touches so many shapes are, if some of them hang together."""
    owner = np.arange(count)
    for i, j in joints:
        owner[owner == owner[i]] = owner[j]
    return len(np.unique(owner))


def joint_costs(values: Array, joints: Joints) -> Array:
    """Return (2 j,) residuals of j joints: cracks, then differences of log contrasts.

    Args:
        values: (n, 7) parameters of the touches.
        joints: Of them.
    """
    if not joints:
        return np.zeros(0)
    cracks = [max(crack(values, one)[0], 0.0) / CRACK_SD_MM for one in joints]
    unlike = [(values[i, LOG_CONTRAST] - values[j, LOG_CONTRAST]) / ALIKE_SD for i, j in joints]
    return np.array(cracks + unlike)


def joint_rates(values: Array, joints: Joints) -> Array:
    """Return (2 j, n, 7) derivatives of the same by the parameters."""
    found = np.zeros((2 * len(joints), *values.shape))
    for number, (i, j) in enumerate(joints):
        wide, axis = crack(values, (i, j))
        if wide > 0.0:
            way = np.sign(values[i, X + axis] - values[j, X + axis]) / CRACK_SD_MM
            found[number, [i, j], X + axis] = way, -way
            found[number, [i, j], HALF_LENGTH + axis] = -1.0 / CRACK_SD_MM
        found[len(joints) + number, [i, j], LOG_CONTRAST] = 1.0 / ALIKE_SD, -1.0 / ALIKE_SD
    return found


def crack(values: Array, pair: tuple[int, int]) -> tuple[float, int]:
    """Return how far two upright rectangles are apart, mm, below 0 where they overlap, and along which axis."""
    i, j = pair
    apart = np.abs(values[i, :2] - values[j, :2]) - (values[i, 2:4] + values[j, 2:4])
    axis = int(np.argmax(apart))
    return float(apart[axis]), axis
