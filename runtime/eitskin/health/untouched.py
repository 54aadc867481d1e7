"""The untouched sheet as a Gaussian around a common factor: a bundle's knowledge of bends, without and with a scan.

A uniform change by a factor moves l = log(V / V0) by one number c in all rows. With mean m and precision P, made at
export from deformations, and log(V_pred / V0) of the cloud in use, zeros without one ::

    r = l - log(V_pred / V0) - m          c = 1^T P r / 1^T P 1          D = (r - c 1)^T P (r - c 1) / 103

A frame with D above a limit is not an untouched sheet at any uniform drift. Below the limit it is an untouched sheet or
a touch: half of the presses of contrast 0.6 are below, and c takes up to 0.9 of their rms. So c is only reported;
removing it from frames needs stricter conditions (:mod:`eitskin.health.drift`).
"""

import numpy as np

from eitskin.health.imputation import Array, Consistency
from eitskin_proto.sensor.row_gaussian import precision_of
from eitskin_proto.sensor.table import N_ROWS


class Untouched:
    """The untouched sheet.

    Args:
        mean: (104,) of l.
        covariance: (104, 104)
        sigma: Error of c on deformations that nothing was learned from.
        limit: D of the farthest of them, and a margin.
    """

    def __init__(self, mean: Array, covariance: Array, sigma: float, limit: float) -> None:
        self._mean, self.sigma, self.limit = mean, float(sigma), float(limit)
        self._precision = precision_of(covariance)
        self._ones = self._precision.sum(axis=0)
        self._weight = float(self._ones.sum())

    @classmethod
    def of(cls, consistency: Consistency, *, predicted: bool) -> "Untouched":
        """Return a bundle's, without or with a prediction."""
        if predicted:
            mean, covariance = consistency.predicted_mean, consistency.predicted_covariance
        else:
            mean, covariance = consistency.untouched_mean, consistency.untouched_covariance
        return cls(mean, covariance, *consistency.drift_limits[int(predicted)])

    def estimate(self, logs: Array) -> tuple[float, float]:
        """Return c, and the distance D of the rest from an untouched sheet.

        Args:
            logs: (104,) l, prediction subtracted.
        """
        rest = logs - self._mean
        drift = float(self._ones @ rest) / self._weight
        rest = rest - drift
        return drift, float(rest @ self._precision @ rest) / (N_ROWS - 1)


def estimates(consistency: Consistency, logs: Array, *, predicted: bool) -> Array:
    """Return (n, 2) c and D of (n, 104) l, prediction subtracted: what a bundle's limits are measured by."""
    model = Untouched.of(consistency, predicted=predicted)
    return np.array([model.estimate(row) for row in logs]).reshape(-1, 2)
