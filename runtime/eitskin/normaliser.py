"""From a frame's counts to dV, into memory that exists already.

A frame carries the 104 rows of the table, or all 208, of which each reciprocal pair is averaged: twice the
measurements, 0.7 of the noise. dV = V / V0 - 1, and 0 in weak rows (:mod:`eitskin_proto.normalise`).
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.normalise import inverse_reference
from eitskin_proto.table import N_FULL_ROWS, N_ROWS, RECIPROCAL_IN_FULL, ROW_IN_FULL

LARGEST_CHANGE: Final = 1e6
"""Strong rows are above 1e-4 of the largest, so that no working front end can change one by more than 1e4."""


class Normaliser:
    """Turns counts into volts and volts into dV.

    Args:
        volts_per_count: V, of HELLO.
    """

    __slots__ = (
        "_exact",
        "_half",
        "_inverse",
        "_offset",
        "_other",
        "_size",
        "voltages",
        "volts_per_count",
        "weak_count",
    )

    def __init__(self, volts_per_count: float) -> None:
        self.volts_per_count = volts_per_count
        self.voltages = np.zeros(N_ROWS)
        """(104,) V of the last frame."""
        self.weak_count = 0
        """Rows of the reference that carry no information."""
        self._inverse = np.zeros(N_ROWS)
        self._offset = np.zeros(N_ROWS)
        self._exact = np.zeros(N_ROWS)
        self._size = np.zeros(N_ROWS)
        self._half = np.zeros(N_ROWS, dtype=np.int32)
        self._other = np.zeros(N_ROWS, dtype=np.int32)

    def use(self, reference: npt.NDArray[np.float64]) -> None:
        """Normalise against a reference from the next frame on.

        Args:
            reference: (104,) V.

        Raises:
            ValueError: It holds no voltage at all.
        """
        self._inverse[:] = inverse_reference(reference)
        self._offset[:] = self._inverse != 0.0
        self.weak_count = N_ROWS - int(self._offset.sum())

    def load(self, counts: npt.NDArray[np.int32]) -> None:
        """Fill ``voltages``.

        Args:
            counts: (104,) or (208,).
        """
        if len(counts) == N_FULL_ROWS:
            # mode="clip" writes straight into out; the indices are constants and in range
            np.take(counts, ROW_IN_FULL, out=self._half, mode="clip")
            np.take(counts, RECIPROCAL_IN_FULL, out=self._other, mode="clip")
            np.add(self._half, self._other, out=self.voltages, dtype=np.float64)  # int32 would overflow
            np.multiply(self.voltages, 0.5 * self.volts_per_count, out=self.voltages)
        else:
            np.multiply(counts, self.volts_per_count, out=self.voltages)

    def change_into(self, out: npt.NDArray[np.float32]) -> bool:
        """Write dV of ``voltages`` and return whether all of it is plausible.

        Args:
            out: (104,); left as it was if not.
        """
        np.multiply(self.voltages, self._inverse, out=self._exact)
        np.subtract(self._exact, self._offset, out=self._exact)
        np.abs(self._exact, out=self._size)
        if not self._size.max() <= LARGEST_CHANGE:  # also false for NaN
            return False
        out[:] = self._exact
        return True
