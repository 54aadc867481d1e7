"""The true sheets of the benchmark: solved on a mesh of their own, once for all rows that ask for the same scene."""

from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.evaluation.device import Device, draw_device
from eitskin_sim.evaluation.mismatch import Mismatch
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.parts import Bend, Scene

Array = npt.NDArray[np.float64]

ELEMENT_MM: Final = 2.0
"""Of the true sheets' mesh, whose lines are not those of the models'."""

SEED: Final = 61_007
"""Names touches, noise and scans; deformations are those of the trials."""


@lru_cache(maxsize=4096)
def volts(scene: Scene) -> Array:
    """Return the (104,) V of a scene."""
    return solve_scene(replace(scene, element_size_mm=ELEMENT_MM)).voltages


def device_of(mismatch: Mismatch, number: int) -> Device:
    """Return the device of a deformation's number: the same draws, whatever the mismatch."""
    return draw_device(mismatch, 0, number)


def cloud_of(device: Device, bend: Bend, number: int) -> Array:
    """Return the (3, rows, columns) mm scan of a deformation."""
    cloud = device.cloud(bend, np.random.default_rng([SEED, number]))
    assert cloud is not None
    return cloud
