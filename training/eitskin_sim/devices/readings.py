"""The readings of a device's instrument: the generators' potentials, corrected for mesh error, through the front end.

A generator's mesh is coarse, and a scene's is fine. The untouched sheet is solved on both, which gives the coarse one's
error for each drive d and each pair of neighbours m: D = d_k^T U d_m, with U the potentials of electrodes for 1 A into
each. Every touched D is multiplied by this correction; a drive's own pair follows because voltages add up to zero round
the ring. From D follow potentials, up to a constant, and from these the front end's readings.
"""

from typing import Final

import numpy as np

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.arrays import Array
from eitskin_sim.devices.device import Device
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.scene.parts import Bend, Scene

FINE_MM: Final = 3.0
"""Element size: the untouched voltages of 16 drawn electrodes are 2e-4 from converged, and 1e-4 over the flat ones."""


def drive_differences(responses: Array) -> Array:
    """Return D (..., 16 drives, 16 pairs), V for 1 A, of potentials (..., 16, 16) for 1 A into each electrode."""
    drives = responses - np.roll(responses, -1, axis=-1)
    return np.swapaxes(drives - np.roll(drives, -1, axis=-2), -1, -2)


def responses_of(differences: Array) -> Array:
    """Return potentials (..., 16, 16) for 1 A into each electrode, the first one's at 0, of D (..., 16, 16)."""
    steps = np.zeros((N_ELECTRODES, N_ELECTRODES))
    steps[np.tril_indices(N_ELECTRODES, -1)] = -1.0
    return np.asarray(steps @ differences @ steps.T)


def corrected(differences: Array, ratio: Array) -> Array:
    """Return D (..., 16, 16) multiplied by a ratio (16, 16), and closed round the ring by each drive's own pair."""
    found = differences * ratio
    own = np.arange(N_ELECTRODES)
    found[..., own, own] = 0.0
    found[..., own, own] = -found.sum(axis=-1)
    return np.asarray(found)


def sheet_differences(device: Device, bend: Bend, element_size_mm: float = FINE_MM) -> Array:
    """Return D (16, 16) of a device's bent, untouched sheet, on a mesh of its own."""
    scene = Scene(sheet=device.sheet, electrodes=device.electrodes, bend=bend, element_size_mm=element_size_mm)
    return factorise_scene(scene).differences()


def readings(device: Device, differences: Array) -> Array:
    """Return (..., 104) V that a device's instrument reads under 1 A, of D (..., 16, 16)."""
    return device.front_end.read(responses_of(differences))
