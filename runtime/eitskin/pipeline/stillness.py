"""Decides whether a frame differs by more than noise from the frame whose map was computed last.

The captured reference says how much each row of a resting sheet varies from frame to frame. The difference of two
frames of an unchanged scene then has a known size, and over n rows its mean square is 1, give or take sqrt(2 / n)::

    z = (dV - dV of the kept frame) * |V0| / (sqrt(2) spread)         still, if mean z^2 <= 1 + 3 sqrt(2 / n)

(A spread of few frames is itself uncertain: with nu = frames - 1, z^2 follows Fisher's F(1, nu), of which mean and
variance are used. A row of which the converter shows only a few steps may rest on one and then flip between two, so no
spread is less than half a step.) About one in 700 frames of a resting scene is computed needlessly, and what can stay
unseen is a change of 0.9 of a frame's own noise (rms over rows), for ``REFRESH_FRAMES`` at most. The kept frame does
not move along, so a touch that grows slowly adds up until it is seen. A spread above ``LARGEST_SPREAD`` is not used,
because with such a reference hardly anything would count as a change.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.normalise import weak_rows
from eitskin_proto.sensor.table import N_ROWS

REFRESH_FRAMES: Final = 100
"""A map is computed and published in full at least this often: half a second at 200 frames/s."""

SMALLEST_SPREAD: Final = 1e-5
"""Of the reference's voltage: a recording or a simulation without noise has none."""

LARGEST_SPREAD: Final = 0.01
"""Of the reference's voltage, three times the noise at 50 dB."""

FEWEST: Final = 4
"""Degrees of freedom up to which F(1, nu) has no variance."""

SIGMAS: Final = 3.0
"""By how many standard deviations of the mean square a resting scene may exceed 1."""


class Stillness:
    """Compares frames with the one that was kept; allocates nothing a frame.

    Args:
        rows: Of a frame.
    """

    __slots__ = ("_difference", "_kept", "_limit", "_weight", "age", "holds")

    def __init__(self, rows: int = N_ROWS) -> None:
        self._kept = np.zeros(rows, dtype=np.float32)
        self._difference = np.zeros(rows, dtype=np.float32)
        self._weight = np.zeros(rows, dtype=np.float32)
        self._limit = 0.0
        self.age = 0
        """Frames since the kept one."""
        self.holds = False
        """Whether there is a kept frame."""

    def use_reference(
        self, voltages_V: npt.NDArray[np.float64], spread_V: npt.NDArray[np.float64], frames: int, step_V: float = 0.0
    ) -> None:
        """Judge by another reference from the next frame on.

        Args:
            voltages_V: (rows,) V.
            spread_V: (rows,) V, standard deviation of a single frame.
            frames: How many frames the spread is of; with fewer than 6 nothing is ever still.
            step_V: Of the converter.
        """
        freedom = frames - 1
        usable = ~weak_rows(voltages_V)
        count = int(usable.sum())
        size = np.abs(voltages_V[usable])
        believed = np.clip(spread_V[usable] / size, SMALLEST_SPREAD, LARGEST_SPREAD)
        self._weight[:] = 0.0
        self._weight[usable] = 1.0 / (np.sqrt(2.0) * np.maximum(believed, 0.5 * step_V / size))
        if freedom > FEWEST:
            mean, variance = freedom / (freedom - 2), 2.0 * (freedom - 1) / (freedom - 4)
            self._limit = float(count * mean * (1.0 + SIGMAS * np.sqrt(variance / count)))
        else:
            self._limit = -1.0
        self.holds = False

    def still(self, change: npt.NDArray[np.float32]) -> bool:
        """Return whether a frame is the kept one within noise, and count it.

        Args:
            change: (rows,) dV.
        """
        self.age += 1
        if not self.holds or self.age >= REFRESH_FRAMES:
            return False
        np.subtract(change, self._kept, out=self._difference)
        np.multiply(self._difference, self._weight, out=self._difference)
        return bool(self._difference.dot(self._difference) <= self._limit)

    def keep(self, change: npt.NDArray[np.float32]) -> None:
        """Compare with this frame from now on.

        Args:
            change: (rows,) dV; copied.
        """
        self._kept[:] = change
        self.age = 0
        self.holds = True

    def reset(self) -> None:
        """Keep none: the next frame is computed whatever it is."""
        self.holds = False
