"""Rows of a recording: those of the table among all 208, and their noise."""

import numpy as np

from eitskin_proto.sensor.table import N_FULL_ROWS, ROW_IN_FULL
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array


def of_table(values: Array) -> Array:
    """Return the (104, ...) of the table, of (104, ...) or of (208, ...)."""
    return values[ROW_IN_FULL] if len(values) == N_FULL_ROWS else values


def noise_V(skin: Skin, volts: Array, level: float, frames: int) -> Array:
    """Return (rows,) standard deviations of what noise does to the mean of some frames."""
    size = np.sqrt(np.mean(volts**2)) * np.ones(len(volts)) if skin.front_end.noise == "N3" else np.abs(volts)
    return np.asarray(level * size / np.sqrt(frames))
