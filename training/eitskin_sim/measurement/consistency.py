"""What 104 rows look like together on a healthy sheet, and what it says about rows that are not there.

Sixteen electrodes give 104 rows, but touches and deformations move them together: given 78 rows of fifteen electrodes,
the 26 of the sixteenth are known to half or a third of their spread. A Gaussian of l = log(V / V0), fitted to samples
with noise, is all that is kept. With P its precision (inverse covariance) and y = P (l - mean), the rows m that are
missing have

    conditional mean   l_m - P_mm^-1 y_m        surprise   y_m^T P_mm^-1 y_m

whatever stands in l_m for the first, and against what was measured for the second. Nothing of the other rows' block is
ever inverted.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS, TABLE

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.bool_]

RATIO_RANGE: Final = (1e-2, 8.0)
"""V / V0 is cut off here before its logarithm: noise can take a weak row through zero, no touch takes one beyond."""

SAMPLES: Final = 40_000
"""Samples that a fit takes."""

FLOOR: Final = 1e-5
"""Added to every row's variance: (0.3 %)^2, the noise of 50 dB, without which few samples have no inverse."""


@dataclass(frozen=True, slots=True)
class Consistency:
    """The Gaussian of l = log(V / V0).

    Args:
        mean: (104,)
        covariance: (104, 104)
    """

    mean: Array
    covariance: Array

    def precision(self) -> Array:
        """Return (104, 104) P."""
        found = np.linalg.inv(self.covariance)
        return np.asarray((found + found.T) / 2.0)


def logarithms(change: npt.NDArray[np.floating]) -> Array:
    """Return log(V / V0) of dV, cut off at ``RATIO_RANGE``."""
    return np.asarray(np.log(np.clip(1.0 + np.asarray(change, dtype=np.float64), *RATIO_RANGE)))


def fit(change: npt.NDArray[np.floating]) -> Consistency:
    """Return the Gaussian of samples.

    Args:
        change: (n, 104) dV, with the noise that a device has: without it some rows would follow from others exactly.

    Raises:
        ValueError: There are not two samples, or they are not of 104 rows.
    """
    if change.ndim != 2 or change.shape[1] != N_ROWS or len(change) < 2:
        raise ValueError(f"consistency of samples {change.shape}; expected at least 2 of {N_ROWS} rows")
    logs = logarithms(change)
    mean = logs.mean(axis=0)
    apart = logs - mean
    return Consistency(mean, apart.T @ apart / (len(logs) - 1) + FLOOR * np.eye(N_ROWS))


def rows_of(electrodes: tuple[int, ...]) -> Rows:
    """Return (104,) which rows drive or measure at any of these electrodes."""
    ends = np.concatenate([TABLE, (TABLE + 1) % N_ELECTRODES], axis=1)
    return np.asarray(np.isin(ends, electrodes).any(axis=1))


class Filler:
    """Fills in the rows of lost electrodes; what a set of electrodes needs is kept for the next time.

    Args:
        consistency: The Gaussian.
    """

    def __init__(self, consistency: Consistency) -> None:
        self._mean = consistency.mean
        self._precision = consistency.precision()
        self._known: dict[tuple[int, ...], tuple[Rows, Array]] = {}

    def fill(self, change: npt.NDArray[np.floating], electrodes: tuple[int, ...]) -> None:
        """Overwrite, in (n, 104) dV, the rows of electrodes by their conditional mean given the other rows."""
        rows, weights = self._of(electrodes)
        apart = logarithms(change[:, ~rows]) - self._mean[~rows]
        logs = self._mean[rows] - apart @ weights.T
        low, high = np.log(RATIO_RANGE)
        change[:, rows] = np.expm1(np.clip(logs, low, high))

    def _of(self, electrodes: tuple[int, ...]) -> tuple[Rows, Array]:
        """Return which rows are missing, and P_mm^-1 P_mo."""
        if electrodes not in self._known:
            rows = rows_of(electrodes)
            inner = self._precision[np.ix_(rows, rows)]
            self._known[electrodes] = (
                rows,
                np.asarray(np.linalg.solve(inner, self._precision[np.ix_(rows, ~rows)]), dtype=np.float64),
            )
        return self._known[electrodes]
