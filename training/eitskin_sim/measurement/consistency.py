"""The correlation of rows on a healthy sheet: a Gaussian of noisy samples, which fills in missing rows.

Sixteen electrodes give 104 rows, but touches and deformations move them together: given 78 rows of fifteen electrodes,
the 26 of the sixteenth are known to half or a third of their spread. A Gaussian of l = log(V / V0), fitted to samples
with noise, is all that is kept; :mod:`eitskin_proto.sensor.row_gaussian` estimates missing rows with it.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.row_gaussian import (
    Array,
    RowGaussian,
    Rows,
    change_of_log,
    log_of_change,
    missing_weights,
    rows_of,
)
from eitskin_proto.sensor.table import N_ROWS

MAX_SAMPLES: Final = 40_000
"""Samples that a fit takes."""

VARIANCE_FLOOR: Final = 1e-5
"""Added to every row's variance: (0.3 %)^2, the noise of 50 dB, without which few samples have no inverse."""


def fit(change: npt.NDArray[np.floating]) -> RowGaussian:
    """Return the Gaussian of samples.

    Args:
        change: (n, 104) dV, with the noise that a device has: without it some rows would follow from others exactly.

    Raises:
        ValueError: There are not two samples, or they are not of 104 rows.
    """
    if change.ndim != 2 or change.shape[1] != N_ROWS or len(change) < 2:
        raise ValueError(f"consistency of samples {change.shape}; expected at least 2 of {N_ROWS} rows")
    logs = log_of_change(change)
    mean = logs.mean(axis=0)
    apart = logs - mean
    return RowGaussian(mean, apart.T @ apart / (len(logs) - 1) + VARIANCE_FLOOR * np.eye(N_ROWS))


class RowImputation:
    """Fills in the rows of missing electrodes; what a set of electrodes needs is kept for the next time.

    Args:
        gaussian: How rows go together.
    """

    def __init__(self, gaussian: RowGaussian) -> None:
        self._mean = gaussian.mean
        self._precision = gaussian.precision()
        self._known: dict[tuple[int, ...], tuple[Rows, Array]] = {}

    def fill(self, change: npt.NDArray[np.floating], electrodes: tuple[int, ...]) -> None:
        """Overwrite, in (n, 104) dV, the rows of electrodes by their conditional mean given the other rows."""
        rows, weights = self._of(electrodes)
        apart = log_of_change(change[:, ~rows]) - self._mean[~rows]
        change[:, rows] = change_of_log(self._mean[rows] - apart @ weights.T)

    def _of(self, electrodes: tuple[int, ...]) -> tuple[Rows, Array]:
        """Return which rows are missing, and what they follow the others with."""
        if electrodes not in self._known:
            rows = rows_of(electrodes)
            self._known[electrodes] = rows, missing_weights(self._precision, rows)
        return self._known[electrodes]
