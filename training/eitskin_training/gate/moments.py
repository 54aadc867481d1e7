"""Untouched moments of random devices: what the gate of a skin that is not the nominal one must call untouched.

A data set of random devices holds an untouched moment a deformation, which is too few to know 104 directions by. More
are solved on a coarse mesh, of other devices from the same distributions: sheet, electrodes, late fields and front end
are drawn, and the reference is the device's own, bent or stretched as it may be. ::

    log(V / V0)        V at the bend with what came since, V0 before it; both through one front end and on one mesh

What came since is no bend's, and hundreds of sheets are too few for it: an uneven drift looks much like a press. So
where the gate learns it is left out of them, and its first order is put on every frame that is drawn (:class:`Fields`).
The common factor is in none of them: it is another in every frame, and is drawn when frames are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.grid import SHEET_MM, pixel_centres_mm
from eitskin_proto.sensor.table import N_ROWS
from eitskin_sim.dataset.device_files import USABLE
from eitskin_sim.devices.device import Device
from eitskin_sim.devices.draws import draw_device, draw_front_end, draw_moment
from eitskin_sim.devices.readings import readings
from eitskin_sim.devices.uncertainties import Uncertainties
from eitskin_sim.fem.solve import factorise_scene, solve_scene
from eitskin_sim.scene.device.layer import smooth_field
from eitskin_sim.scene.parts import Bend, Scene, SmoothField
from eitskin_training.gate.observer import flat_jacobian

Array = npt.NDArray[np.float64]

COARSE_MM: Final = 4.5
"""Element size: 0.08 CPU-seconds a solve."""

SEED: Final = 0xDE71

FIELDS: Final = 1000
"""Different smooth fields that frames are drawn from; their sheets and images are more."""


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


@dataclass(frozen=True, slots=True)
class Fields:
    """Changes of log V by uneven drift, of first order on the flat nominal sheet, as many as are asked for.

    Args:
        spread: How strong they are.
        tilts: (2, 104) by a tilt of rms 1 along the sheet, and across.
        fields: (n, 104) by smooth fields of rms 1.
    """

    spread: Uncertainties
    tilts: Array
    fields: Array

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Return (count, 104) changes of log V; none for the share of moments that has no uneven drift."""
        spread = self.spread
        tilt, field = (
            np.exp(rng.uniform(*np.log(bounds), count)) for bounds in (spread.late_gradient_rms, spread.late_field_rms)
        )
        turn = rng.uniform(0.0, 2.0 * np.pi, count)
        sign = rng.choice((-1.0, 1.0), count)
        found = (sign * field)[:, None] * self.fields[rng.integers(len(self.fields), size=count)]
        found += tilt[:, None] * (np.column_stack([np.cos(turn), np.sin(turn)]) @ self.tilts)
        found[rng.random(count) < spread.late_even] = 0.0
        return found


@cache
def fields_of(spread: Uncertainties) -> Fields:
    """Return fields of the correlations of a spread, always the same."""
    rng = np.random.default_rng([SEED, FIELDS])
    jacobian, xy = flat_jacobian(), pixel_centres_mm().reshape(-1, 2)
    lengths, seeds = rng.uniform(*spread.correlation_mm, FIELDS), rng.integers(2**31, size=FIELDS)
    drawn = [
        smooth_field(SmoothField(1.0, float(length), int(seed)), xy)
        for length, seed in zip(lengths, seeds, strict=True)
    ]
    across = np.sqrt(12.0) * (xy / np.array(SHEET_MM) - 0.5)
    return Fields(spread, across.T @ jacobian.T, np.array(drawn) @ jacobian.T)


LEAST_RATIO: Final = 0.05
"""V / V0 is not taken for less, as in the gate: an offset may turn the sign of a weak row."""


def _differences(device: Device, bend: Bend) -> Array:
    scene = Scene(sheet=device.sheet, electrodes=device.electrodes, bend=bend, element_size_mm=COARSE_MM)
    return factorise_scene(scene).differences()


def _usable(share: Array) -> bool:
    return bool(USABLE[0] < share.min() and share.max() < USABLE[1])
