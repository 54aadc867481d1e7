"""Rows of touched units on a solid slab: voltages that no sheet model made, flat and bent, verified by one.

The slab is solved in three dimensions on two meshes, and extrapolated (:mod:`eitskin_tools.bench.physics`). It costs
minutes, so its touches are few: a unit within, one at the edge, one in the corner and two at once; noise is drawn anew
for each law.
"""

from typing import Final

import numpy as np

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation.devices.mismatch import IDEAL
from eitskin_sim.measurement.noise import Kind, add_noise
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_tools.bench.physics.against_solid import BENT, COARSE, FLAT
from eitskin_tools.bench.physics.solid import build_solid
from eitskin_tools.bench.physics.solid_mesh import extrapolated
from eitskin_tools.bench.verify.truth import SEED, Array, cloud_of, device_of

SHEETS: Final[dict[str, Bend]] = {"3-D slab, flat": FLAT, "3-D slab, bent": BENT}
LAWS: Final[tuple[Kind, ...]] = ("N1", "N2", "N3")

PLACES: Final = (((4, 6),), ((0, 6),), ((0, 0),), ((2, 3), (6, 10)))
"""Rows and columns of touched units: within, at the edge, in the corner, and two."""


def frames(name: str) -> list[tuple[Array, Array, Array, list[int], Kind]]:
    """Return V, the flat slab's V, the cloud, the touched units and the noise's law of every frame of a slab."""
    bend = SHEETS[name]
    flat = _solved(FLAT, [()])[0]
    solved = _solved(bend, [tuple(_touch(*place) for place in places) for places in PLACES])
    cloud = cloud_of(device_of(IDEAL, 0), bend, 0)
    found = []
    for number, (volts, places) in enumerate(zip(solved, PLACES, strict=True)):
        units = [row * PAPER.grid.units[1] + column for row, column in places]
        for law in LAWS:
            noisy = add_noise(volts, flat, law, 50.0, np.random.default_rng([SEED, number]))
            found.append((noisy, flat, cloud, units, law))
    return found


def _touch(row: int, column: int) -> Touch:
    return Touch((Rect(*PAPER.grid.unit_rect_mm(column, row)),))


def _solved(bend: Bend, touches: list[tuple[Touch, ...]]) -> list[Array]:
    """Return the (104,) V of each touch set, extrapolated from two meshes."""
    every = tuple(one for some in touches for one in some)
    coarse, fine = (build_solid(Scene(bend=bend), one, every) for one in (COARSE, COARSE.halved()))
    return [extrapolated(coarse.voltages(some)[0], fine.voltages(some)[0])[0] for some in touches]
