"""The untouched sheet's voltages: the mean of some still, untouched frames, when it has changed.

The untouched voltages show the verifier how the sheet differs from its scan (:mod:`eitskin_sim.verification.at_rest`).
It takes a third of a second of rest, and is given again once it has changed: after a press that left something
behind, or by drift.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.model.stillness import MOST_FUSED, Stillness

Array = npt.NDArray[np.float64]

BASELINE_FRAMES: Final = MOST_FUSED
"""That the mean is of."""

MIN_NEW_RMS: Final = 1e-3
"""Rms of dV by which a mean differs from the last one, or it is no news: the model is not better either."""


class UntouchedBaseline:
    """Gathers untouched frames of one surface under one reference."""

    def __init__(self) -> None:
        self._stillness = Stillness()
        self._last: Array | None = None

    def start(
        self, voltages_V: Array, spread_V: Array, frames: int, step_V: float, shared_V: Array | None = None
    ) -> None:
        """Start with another surface or reference; arguments as of :class:`eitskin.model.stillness.Stillness`."""
        self._stillness.use_reference(voltages_V, spread_V, frames, step_V, shared_V)
        self._last = None

    def reset(self) -> None:
        """Restart after a touch."""
        self._stillness.reset()

    def add(self, change: npt.NDArray[np.float32]) -> Array | None:
        """Count an untouched frame, and return the mean of ``BASELINE_FRAMES`` where it is news.

        Args:
            change: (104,) dV.
        """
        stillness = self._stillness
        if not stillness.take(change) or stillness.frames < BASELINE_FRAMES:
            return None
        mean = stillness.mean.astype(np.float64)
        stillness.reset()
        if self._last is not None and np.sqrt(np.mean(np.square(mean - self._last))) < MIN_NEW_RMS:
            return None
        self._last = mean
        return mean
