"""The untouched sheet's voltages: the mean of some still, untouched frames, when it has changed.

The untouched voltages show the verifier how the sheet differs from its scan (:mod:`eitskin_sim.verification.at_rest`).
It takes a quarter of a second of rest, and is given again once it has changed: after a press that left something
behind, or by drift.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.pipeline.stillness import Stillness
from eitskin_proto.sensor.table import N_ROWS

Array = npt.NDArray[np.float64]

BASELINE_FRAMES: Final = 50
"""That the mean is of."""

MIN_NEW_RMS: Final = 1e-3
"""Rms of dV by which a mean differs from the last one, or it is no news: the model is not better either."""


class UntouchedBaseline:
    """Gathers untouched frames of one surface under one reference."""

    def __init__(self) -> None:
        self._stillness = Stillness()
        self._sum: Array = np.zeros(N_ROWS)
        self._count = 0
        self._last: Array | None = None

    def start(self, voltages_V: Array, spread_V: Array, frames: int, step_V: float) -> None:
        """Start with another surface or reference; arguments as of :meth:`eitskin.pipeline.stillness.Stillness.use`."""
        self._stillness.use_reference(voltages_V, spread_V, frames, step_V)
        self._last = None

    def reset(self) -> None:
        """Restart after a touch."""
        self._stillness.reset()

    def add(self, change: npt.NDArray[np.float32]) -> Array | None:
        """Count an untouched frame, and return the mean of ``BASELINE_FRAMES`` where it is news.

        Args:
            change: (104,) dV.
        """
        self._stillness.age = 0
        if not self._stillness.still(change):
            self._stillness.keep(change)
            self._sum[:], self._count = 0.0, 0
        self._sum += change
        self._count += 1
        if self._count < BASELINE_FRAMES:
            return None
        mean = self._sum / self._count
        self._stillness.reset()
        if self._last is not None and np.sqrt(np.mean(np.square(mean - self._last))) < MIN_NEW_RMS:
            return None
        self._last = mean
        return mean
