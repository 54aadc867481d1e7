"""Has the sheet's conductivity changed since its one reference was taken? Drying and warmth move every row alike.

A uniform change by a factor moves l = log(V / V0) by one number c in all rows. So does a stretch that is the same in
every direction: voltages alone cannot tell the two apart, and what is left of c is known to a tenth. With a cloud,
V_pred says what the shape does, and c is known to half a percent. In both cases the untouched sheet is a Gaussian, of
mean m and precision P, made at export from deformations ::

    r = l - log(V_pred / V0) - m          c = 1^T P r / 1^T P 1          D = (r - c 1)^T P (r - c 1) / 103

D above its limit is no untouched sheet at any uniform drift, so such a frame says nothing of drift: a touch is a
pattern, and c is the one pattern that it is not. Frames are averaged, and c is reported once it has been plausible for
``HOLD`` frames. A sheet that dries more at one end than at the other is beyond the limit as well: if it is so by
``UNEVEN`` times, nothing touches it for as long by the gate, and there is a V_pred, its reference is called ``uneven``:
no number, and nothing to take out. Between the two nothing is said. Compensation, if it is asked for, takes out c and
nothing else, moves by ``SLOPE`` a frame at most, and only where there is a prediction.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.health.imputation import Array, Consistency
from eitskin_proto.sensor.table import N_ROWS

HOLD: Final = 400
"""Plausible frames in a row before drift is reported: two seconds at 200 frames/s."""

AVERAGED: Final = 50.0
"""Frames over which l is averaged."""

SLOPE: Final = 1e-5
"""Most that the compensation moves a frame, in log: 0.2 % a second at 200 frames/s; a sheet dries in hours."""

UNEVEN: Final = 2.0
"""Times the limit: one in nine bends of family B, whose clouds tell less than A's, lies between once and 1.7 times."""

SIGMAS: Final = 3.0
"""Drift is an event above so many of its standard deviations, and above ``LEAST``."""

LEAST: Final = 0.02
"""Smallest drift worth an event, in log."""


class Drift:
    """Follows the reference's drift, one frame after another.

    Args:
        consistency: Of the bundle.
        compensate: Whether to take it out of the frames.
    """

    def __init__(self, consistency: Consistency, *, compensate: bool = False) -> None:
        self._models = (
            _Model(consistency.untouched_mean, consistency.untouched_covariance, *consistency.drift_limits[0]),
            _Model(consistency.predicted_mean, consistency.predicted_covariance, *consistency.drift_limits[1]),
        )
        self._low_high = (float(consistency.ratio_range[0]) - 1.0, float(consistency.ratio_range[1]) - 1.0)
        self._compensate = compensate
        self._average = np.zeros(N_ROWS)
        self._plausible = 0
        self._seen = 0
        self._told = False
        self._strange = 0
        self.uneven = False
        """The sheet is untouched, yet far from what reference and cloud say, and not by a common factor."""
        self._steady = np.zeros(0)
        self.taken_out = 0.0
        """What compensation has taken out so far, in log."""
        self.percent = float("nan")
        """Change of the voltages against the reference, all rows alike; not a number while unknown."""
        self.sigma_percent = float("nan")
        """Its standard deviation, measured on deformations that nothing was learned from."""

    def restart(self) -> None:
        """Forget everything: there is a new reference."""
        self._average[:] = 0.0
        self._plausible = self._seen = self._strange = 0
        self._told = self.uneven = False
        self.taken_out = 0.0
        self.percent = self.sigma_percent = float("nan")

    def correct(self, change: npt.NDArray[np.float32]) -> None:
        """Take the drift out of (104,) dV, in place, as far as compensation has come."""
        if self.taken_out:
            factor = float(np.exp(-self.taken_out))
            np.add(change, np.float32(1.0), out=change)
            np.multiply(change, np.float32(factor), out=change)
            np.subtract(change, np.float32(1.0), out=change)

    def look(self, change: npt.NDArray[np.float32], predicted: npt.NDArray[np.float32], *, touched: bool) -> bool:
        """Take the evidence of one frame or of several and return whether a frame should say that there is drift.

        Args:
            change: (104,) or (n, 104) dV before compensation, failed rows filled in.
            predicted: (104,) log(V_pred / V0) of the cloud in use; zeros without one.
            touched: What the gate says of the frame, or of any of them.
        """
        logs = np.maximum(np.atleast_2d(change), self._low_high[0], dtype=np.float64)
        np.minimum(logs, self._low_high[1], out=logs)
        np.log1p(logs, out=logs)
        frames = len(logs)
        weights = self._weights(frames)
        np.multiply(self._average, weights[0], out=self._average)
        np.add(self._average, weights[1:] @ logs, out=self._average)
        with_scan = bool(predicted.any())
        model = self._models[with_scan]
        drift, distance = model.estimate(self._average - predicted)
        if distance > model.limit:
            self._plausible = 0
            return self._is_uneven(frames, touched=touched or not with_scan or distance <= UNEVEN * model.limit)
        self._strange, self.uneven = 0, False
        self._plausible += frames
        if self._plausible < HOLD:
            return False
        self.percent = 100.0 * float(np.expm1(drift))
        self.sigma_percent = 100.0 * model.sigma
        if self._compensate and with_scan and not (touched and abs(drift - self.taken_out) < LEAST):
            most = SLOPE * frames
            self.taken_out += min(max(drift - self.taken_out, -most), most)
        told = abs(drift) > max(SIGMAS * model.sigma, LEAST)
        fresh = told and not self._told
        self._told = told
        return fresh

    def _is_uneven(self, frames: int, *, touched: bool) -> bool:
        """Count frames that fit no untouched sheet though nothing touches it; return whether they are news.

        Args:
            frames: How many.
            touched: They are touched, or may be a sheet that the cloud does not say enough of.
        """
        self._strange = 0 if touched else self._strange + frames
        before, self.uneven = self.uneven, self._strange >= HOLD
        if self.uneven:
            self.percent = float("nan")
        return self.uneven and not before

    def _weights(self, frames: int) -> Array:
        """Return (1 + n,) how much of the running mean and of each of n frames is in the mean after them."""
        if self._seen >= AVERAGED and len(self._steady) == 1 + frames:
            return self._steady
        weights = np.ones(1 + frames)
        for row in range(1, 1 + frames):
            self._seen += 1
            weights[row] = 1.0 / min(float(self._seen), AVERAGED)
            weights[:row] *= 1.0 - weights[row]
        if self._seen - frames >= AVERAGED:
            self._steady = weights
        return weights


class _Model:
    """The untouched sheet, as a Gaussian around a common factor."""

    def __init__(self, mean: Array, covariance: Array, sigma: float, limit: float) -> None:
        self._mean, self.sigma, self.limit = mean, float(sigma), float(limit)
        precision = np.linalg.inv(covariance)
        self._precision = np.asarray((precision + precision.T) / 2.0)
        self._ones = self._precision.sum(axis=0)
        self._weight = float(self._ones.sum())

    def estimate(self, logs: Array) -> tuple[float, float]:
        """Return c, and the distance D of what is left from an untouched sheet."""
        rest = logs - self._mean
        drift = float(self._ones @ rest) / self._weight
        rest = rest - drift
        return drift, float(rest @ self._precision @ rest) / (N_ROWS - 1)


def estimates(consistency: Consistency, logs: Array, *, predicted: bool) -> Array:
    """Return (n, 2) c and D of (n, 104) l, prediction subtracted: what a bundle's limits are measured by."""
    mean = consistency.predicted_mean if predicted else consistency.untouched_mean
    covariance = consistency.predicted_covariance if predicted else consistency.untouched_covariance
    model = _Model(mean, covariance, 0.0, 0.0)
    return np.array([model.estimate(row) for row in logs]).reshape(-1, 2)
