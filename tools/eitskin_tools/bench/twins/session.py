"""What is recorded of a drawn device to calibrate it from, as ``eitskin calibrate --guided`` asks for it.

The reference of all 208 rows, flat and untouched; bends that are held and scanned; presses of a stamp on the flat
sheet, each of which misses its place and its strength as a person's do. Bends and noise are no trial's and no
training's.
"""

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import FULL_TABLE, TABLE
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.calibration.recording import Later, Recording
from eitskin_sim.calibration.stamp import OWN_SPREAD, PLACE_MM, places
from eitskin_sim.devices.readings import FINE_MM, responses_of
from eitskin_sim.evaluation.devices.device import Device
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Scene, Touch
from eitskin_sim.scene.shapes import Disc

Array = npt.NDArray[np.float64]

FRAMES: Final = 100
"""That each moment is the mean of."""

SEED: Final = 1901
"""Of noise, bends and presses."""

STAMP_MM: Final = 16.0
"""Diameter of the stamp."""

PRESSED: Final = {"lowering": (0.5, 4.0), "raising": (10.0, 2.0)}
"""Contrast and border of the stamp's presses, mm: between the two presses of trials, and as the lab mix's touches."""


def recorded(device: Device, number: int, snr_db: float, bends: int, presses: int, way: TouchKind) -> Recording:
    """Return what is recorded of a device.

    Args:
        device: The true one.
        number: Names its bends, how its presses miss, and the noise.
        snr_db: Of one frame.
        bends: How many bends; 0 for none.
        presses: How many presses; 0 for none.
        way: Which way they change conductance, ``lowering`` or ``raising``.
    """
    rng = np.random.default_rng([SEED, number])
    sd = 10.0 ** (-snr_db / 20.0) / FRAMES**0.5

    def read(scene: Scene, table: npt.NDArray[np.uint8] = TABLE) -> Array:
        fine = replace(scene, element_size_mm=FINE_MM)
        volts = device.front_end.read(responses_of(factorise_scene(fine).differences()), table)
        return np.asarray(volts * (1.0 + sd * rng.standard_normal(len(volts))))

    flat = device.reference()
    reference = read(flat, FULL_TABLE)
    bents, pressed = [], []
    for bend in draw("A", bends, SEED + number, device.skin):
        volts = read(device.scene(nominal_scene(device.skin, bend), as_it_is=True))
        bents.append(Later(volts, FRAMES, device.cloud(bend, rng)))
    contrast, border_mm = PRESSED[way]
    for said_mm in places(device.skin.outline.size_mm, presses):
        x_mm, y_mm = said_mm + PLACE_MM * rng.standard_normal(2)
        strength = np.exp(OWN_SPREAD * rng.standard_normal())
        touch = Touch((Disc(x_mm, y_mm, STAMP_MM / 2.0),), contrast=contrast**strength, border_mm=border_mm)
        volts = read(replace(flat, touches=(touch,)))
        pressed.append(Later(volts, FRAMES, xy_mm=np.array(said_mm), stamp_mm=(STAMP_MM,)))
    return Recording(reference, FRAMES, tuple(bents), tuple(pressed))
