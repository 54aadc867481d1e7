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
from eitskin_proto.skin.skin import Skin
from eitskin_sim.dataset.device_files import ATTEMPTS, USABLE, true_bend
from eitskin_sim.devices.device import Device
from eitskin_sim.devices.draws import DrawnDevice, draw_device, draw_front_end, draw_moment, walked
from eitskin_sim.devices.readings import readings
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


def moments(bends: Sequence[Bend], skin: Skin, seed: int, together: int = 2, *, late: bool = True) -> Array:
    """Return (n, 104) log(V / V0) of untouched devices, one at each bend.

    Args:
        bends: Where.
        skin: What devices are drawn from.
        seed: Of the draws.
        together: Bends that share a device, and so a reference.
        late: With the uneven drift since then.

    Raises:
        ValueError: The skin's electronics hardly ever read every row by the sign that it has.
    """
    rng = np.random.default_rng([seed, SEED])
    nominal = solve_scene(Scene(element_size_mm=COARSE_MM)).voltages
    found = np.empty((len(bends), N_ROWS))
    for start in range(0, len(bends), together):
        drawn, own = _referenced(skin, nominal, rng)
        for number in range(start, min(start + together, len(bends))):
            since = draw_moment(skin, rng).late
            device = drawn.device.since(since if late else None)
            read = readings(device, _differences(device, true_bend(drawn, bends[number])))
            found[number] = np.log(np.maximum(read / own, LEAST_RATIO))
    return found


@dataclass(frozen=True, slots=True)
class Fields:
    """Changes of log V by uneven drift, of first order on the flat nominal sheet, as many as are asked for.

    Args:
        skin: How strong they are.
        tilts: (2, 104) by a tilt of rms 1 along the sheet, and across.
        fields: (n, 104) by smooth fields of rms 1.
    """

    skin: Skin
    tilts: Array
    fields: Array

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Return (count, 104) changes of log V, drawn as moments are."""
        rms = rng.uniform(*self.skin.may_be_off.late_rms, count) * walked(count, rng) * rng.choice((-1.0, 1.0), count)
        share, turn = rng.uniform(0.0, np.pi / 2, count), rng.uniform(0.0, 2.0 * np.pi, count)
        found = (rms * np.cos(share))[:, None] * self.fields[rng.integers(len(self.fields), size=count)]
        found += (rms * np.sin(share))[:, None] * (np.column_stack([np.cos(turn), np.sin(turn)]) @ self.tilts)
        return np.asarray(found)


@cache
def fields_of(skin: Skin) -> Fields:
    """Return fields of the correlations of a skin, always the same."""
    rng = np.random.default_rng([SEED, FIELDS])
    jacobian, xy = flat_jacobian(), pixel_centres_mm().reshape(-1, 2)
    lengths, seeds = rng.uniform(*skin.may_be_off.late_correlation_mm, FIELDS), rng.integers(2**31, size=FIELDS)
    drawn = [
        smooth_field(SmoothField(1.0, float(length), int(seed)), xy)
        for length, seed in zip(lengths, seeds, strict=True)
    ]
    across = np.sqrt(12.0) * (xy / np.array(SHEET_MM) - 0.5)
    return Fields(skin, across.T @ jacobian.T, np.array(drawn) @ jacobian.T)


LEAST_RATIO: Final = 0.05
"""V / V0 is not taken for less, as in the gate: an offset may turn the sign of a weak row."""


def _differences(device: Device, bend: Bend) -> Array:
    scene = Scene(sheet=device.sheet, electrodes=device.electrodes, bend=bend, element_size_mm=COARSE_MM)
    return factorise_scene(scene).differences()


def _referenced(skin: Skin, nominal: Array, rng: np.random.Generator) -> tuple[DrawnDevice, Array]:
    """Return a device that can be used and what it reads when its reference is taken."""
    drawn = draw_device(skin, rng)
    before = _differences(drawn.device, drawn.reference_bend)
    for _ in range(ATTEMPTS):
        own = readings(drawn.device, before)
        share = own / nominal
        if USABLE[0] < share.min() and share.max() < USABLE[1]:
            return drawn, own
        drawn = replace(drawn, device=replace(drawn.device, front_end=draw_front_end(skin, rng)))
    raise ValueError(f"skin {skin.name}: no front end of {ATTEMPTS} reads every row; make what is off in it smaller")
