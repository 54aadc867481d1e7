"""Faint presses for the gate's training and for measuring its misses.

A press is known by its strength: the conductance that it takes away over the sheet's, times its area, mm^2. The weakest
measured ones have 99; the gate is asked for half of that.
"""

from typing import Final

import numpy as np

from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.freeform.touches import Ranges
from eitskin_sim.scene.touch_table import DISC

STRENGTH_MM2: Final = 50.0
"""Half of the weakest measured press."""

DIAMETER_MM: Final = 16.0
"""Of the presses that are asked for."""

BORDER_MM: Final = 4.0

STRENGTHS_MM2: Final = (30.0, 150.0)
"""Of those that are learned from, log-uniform; the data set's own are stronger."""


def press(x_mm: float, y_mm: float, diameter_mm: float, contrast: float, border_mm: float = BORDER_MM) -> Array:
    """Return (1, 8) pieces of a disc of a contrast, with a graded border."""
    return np.array([[DISC, x_mm, y_mm, diameter_mm, diameter_mm, 0.0, contrast, border_mm]])


def contrast_of(strength_mm2: float, diameter_mm: float) -> float:
    """Return the contrast of a disc of a strength.

    Raises:
        ValueError: The disc has not so much to give.
    """
    area = np.pi / 4 * diameter_mm**2
    if not strength_mm2 < area:
        raise ValueError(f"a disc of {diameter_mm:g} mm has {area:.0f} mm2, it cannot lose {strength_mm2:g}")
    return float(1.0 - strength_mm2 / area)


def drawn_presses(count: int, rng: np.random.Generator, skin: Skin) -> list[Array]:
    """Return touch sets of one faint press each, as pieces."""
    sets: list[Array] = []
    usual = Ranges("lower")
    (least, most), border_mm = usual.sizes_mm, usual.borders_mm
    while len(sets) < count:
        strength = np.exp(rng.uniform(*np.log(STRENGTHS_MM2)))
        contrast = np.exp(rng.uniform(*np.log(usual.lowering)))
        diameter = float(np.sqrt(4 / np.pi * strength / (1.0 - contrast)))
        border = 0.0 if rng.random() < usual.sharp else float(rng.uniform(border_mm[0], min(border_mm[1], diameter)))
        if least <= diameter <= most:
            x, y = rng.uniform((diameter / 2, diameter / 2), np.array(skin.outline.size_mm) - diameter / 2)
            sets.append(press(float(x), float(y), diameter, float(contrast), border))
    return sets


def probe_presses(seed: int, skin: Skin) -> dict[str, list[Array]]:
    """Return touch sets by name: presses of the strength asked for and of contrasts, anywhere on the sheet."""
    rng = np.random.default_rng(seed)
    wanted = {
        f"press of {STRENGTH_MM2:g} mm2": contrast_of(STRENGTH_MM2, DIAMETER_MM),
        f"press of {2 * STRENGTH_MM2:g} mm2": contrast_of(2 * STRENGTH_MM2, DIAMETER_MM),
        "press of contrast 0.6": 0.6,
        "press of contrast 0.4": 0.4,
    }
    half = DIAMETER_MM / 2
    found = {}
    for name, contrast in wanted.items():
        at = rng.uniform((half, half), np.array(skin.outline.size_mm) - half, (20, 2))
        found[name] = [press(float(x), float(y), DIAMETER_MM, contrast) for x, y in at]
    return found
