"""A family of deformations that is wider than A: dents of any place, height and width besides."""

from dataclasses import replace
from typing import Final

import numpy as np

from eitskin_proto.skin.skin import Skin
from eitskin_sim.scene.family import FLAT, SCALED, bounds, scaled
from eitskin_sim.scene.parts import Bend

DENTED: Final = 0.7
MOST_DENTS: Final = 4
DENT_MM: Final = 7.5
DENT_SIGMA_MM: Final = (10.0, 30.0)
"""Share of the wider family that has dents, how many at most, their greatest height and their width."""


def wide_bends(count: int, seed: int, skin: Skin) -> list[Bend]:
    """Return bends of the wider family. Some fold through themselves, which changes no voltage and is let pass."""
    rng = np.random.default_rng([seed, 0x71DE])
    found = []
    for _ in range(count):
        bend = Bend(**{name: float(rng.uniform(*one)) for name, one in bounds(skin.deformations).items()})  # type: ignore[arg-type]
        if rng.random() < DENTED:
            bend = replace(bend, bumps_mm=tuple(_dent(rng, skin) for _ in range(int(rng.integers(1, MOST_DENTS + 1)))))
        kind, amplitude = rng.random(2)
        found.append(Bend() if kind < FLAT else scaled(bend, float(amplitude)) if kind < FLAT + SCALED else bend)
    return found


def _dent(rng: np.random.Generator, skin: Skin) -> tuple[float, float, float, float]:
    length, width = skin.outline.size_mm
    x, y = rng.uniform((5.0, 5.0), (length - 5.0, width - 5.0))
    return float(x), float(y), float(rng.uniform(-DENT_MM, DENT_MM)), float(rng.uniform(*DENT_SIGMA_MM))
