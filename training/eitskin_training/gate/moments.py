"""Untouched moments of random devices: what the gate of a skin that is not the nominal one must call untouched.

A data set of random devices holds an untouched moment a deformation, which is too few to know 104 directions by. More
are solved on a coarse mesh, of other devices from the same distributions: sheet, electrodes, late fields and front end
are drawn, and the reference is the device's own, bent or stretched as it may be. ::

    log(V / V0)        V at the bend with what came since, V0 before it; both through one front end and on one mesh

The common factor is not in them. It is another in every frame, and is drawn when frames are.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ROWS
from eitskin_sim.dataset.device_files import USABLE
from eitskin_sim.devices.device import Device
from eitskin_sim.devices.draws import draw_device, draw_front_end, draw_moment
from eitskin_sim.devices.readings import readings
from eitskin_sim.devices.uncertainties import Uncertainties
from eitskin_sim.fem.solve import factorise_scene, solve_scene
from eitskin_sim.scene.parts import Bend, Scene

Array = npt.NDArray[np.float64]

COARSE_MM: Final = 4.5
"""Element size: 0.08 CPU-seconds a solve."""

SEED: Final = 0xDE71


def moments(bends: Sequence[Bend], spread: Uncertainties, seed: int, together: int = 2) -> Array:
    """Return (n, 104) log(V / V0) of untouched devices, one at each bend.

    Args:
        bends: Where.
        spread: What devices are drawn from.
        seed: Of the draws.
        together: Bends that share a device, and so a reference.
    """
    rng = np.random.default_rng([seed, SEED])
    nominal = solve_scene(Scene(element_size_mm=COARSE_MM)).voltages
    found = np.empty((len(bends), N_ROWS))
    for start in range(0, len(bends), together):
        drawn = draw_device(spread, rng)
        before = _differences(drawn.device, drawn.reference_bend)
        own = np.zeros(N_ROWS)
        while not _usable(own / nominal):
            device = replace(drawn.device, front_end=draw_front_end(spread, rng))
            own = readings(device, before)
        for number in range(start, min(start + together, len(bends))):
            late = draw_moment(spread, rng).late
            read = readings(device, _differences(device.since(late), bends[number]))
            found[number] = np.log(np.maximum(read / own, LEAST_RATIO))
    return found


LEAST_RATIO: Final = 0.05
"""V / V0 is not taken for less, as in the gate: an offset may turn the sign of a weak row."""


def _differences(device: Device, bend: Bend) -> Array:
    scene = Scene(sheet=device.sheet, electrodes=device.electrodes, bend=bend, element_size_mm=COARSE_MM)
    return factorise_scene(scene).differences()


def _usable(share: Array) -> bool:
    return bool(USABLE[0] < share.min() and share.max() < USABLE[1])
