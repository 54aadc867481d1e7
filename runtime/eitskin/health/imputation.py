"""Continues without an electrode: estimates its rows from the others, or removes them from the projection, exactly.

A healthy sheet's l = log(V / V0) is close to a Gaussian with mean and precision P (made at export, from the data that
the network learned from). With rows m missing and y = P (l - mean), :mod:`eitskin_proto.sensor.row_gaussian` gives ::

    E[l_m | the others] = l_m - P_mm^-1 y_m                               for the network
    M' = M - M_:m K_mm^-1 K_m: with K = (J J^T + tau I)^-1, column m = 0     the projection without these rows

The second is the same identity, and equals building the projection anew from the rows that are left. A row that was
measured, but with noise of variance n that P knows of, is worth less than it says, and is weighed ::

    E[l_q | all rows] = l_q - n_q y_q,      the first being its limit for n towards infinity

A change of the missing rows costs one small solve, a frame one product with a 104-column matrix, an unchanged healthy
frame nothing. Where whole electrodes are gone, a bundle's small network corrects the first
(:mod:`eitskin.health.correction`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.health.correction import Correction, Layers
from eitskin.model.small_products import product
from eitskin_proto.sensor.row_gaussian import change_of_log, log_of_change, missing_weights, precision_of, rows_of
from eitskin_proto.sensor.table import N_ROWS

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.bool_]

SHAPES: Final[Mapping[str, tuple[int, ...]]] = {
    "mean": (N_ROWS,),
    "covariance": (N_ROWS, N_ROWS),
    "ratio_range": (2,),
    "reference": (N_ROWS,),
    "untouched_mean": (N_ROWS,),
    "untouched_covariance": (N_ROWS, N_ROWS),
    "predicted_mean": (N_ROWS,),
    "predicted_covariance": (N_ROWS, N_ROWS),
    "drift_limits": (2, 2),
    "projection_inverse": (N_ROWS, N_ROWS),
    "thresholds": (2,),
}
"""Arrays of consistency.npz."""

UNPREDICTED: Final = np.zeros(N_ROWS, dtype=np.float32)
"""log(V_pred / V0) where nothing was predicted."""

MISSING: Final = "not available in this bundle: use one that 'eitskin build' trained, without --physics"


@dataclass(frozen=True, slots=True, eq=False)
class Consistency:
    """The joint distribution of rows, read from a bundle."""

    mean: Array
    """(104,) of l = log(V / V0)."""
    covariance: Array
    """(104, 104)"""
    ratio_range: Array
    """(2,) where V / V0 is cut off before its logarithm."""
    reference: Array
    """(104,) V under 1 A of the forward model, flat and untouched: what a sound reference looks like."""
    untouched_mean: Array
    """(104,) of l over deformations alone."""
    untouched_covariance: Array
    """(104, 104)"""
    predicted_mean: Array
    """(104,) of l - log(V_pred / V0) over deformations."""
    predicted_covariance: Array
    """(104, 104)"""
    drift_limits: Array
    """(2, 2) without and with a prediction: error of a common factor, and the distance of the farthest bend."""
    projection_inverse: Array
    """(104, 104) K of the bundle's projection."""
    thresholds: Array
    """(2,) an electrode's surprise and a whole frame's, above which they are no touch and no deformation."""
    layers: Layers | None = None
    """The correction of filled-in rows; None in a bundle whose network was not trained with it."""

    @classmethod
    def of(cls, arrays: Mapping[str, npt.NDArray[np.generic]]) -> "Consistency":
        """Return a bundle's arrays, checked.

        Raises:
            BundleError: One is missing, has another shape, or is not finite.
        """
        found: dict[str, Array] = {}
        for name, shape in SHAPES.items():
            value = np.asarray(arrays[name], dtype=np.float64) if name in arrays else np.zeros(0)
            if value.shape != shape or not np.isfinite(value).all():
                raise BundleError(
                    f"consistency.npz: {name} found {value.shape}, expected {shape} finite numbers; make the bundle "
                    "again with 'eitskin export'"
                )
            found[name] = value
        return cls(**found, layers=Layers.of(arrays))

    def precision(self, extra: Array | None = None) -> Array:
        """Return (104, 104) P, with (104,) more variance of the rows where a device is noisier than the samples."""
        whole = self.covariance if extra is None else self.covariance + np.diag(extra)
        return precision_of(whole)


class Imputation:
    """Fills rows in, one frame after another.

    Args:
        mean: (104,) of l.
        precision: (104, 104) P.
        ratio_range: Where V / V0 is cut off.
        layers: What corrects the rows of lost electrodes, if there is such a thing.
    """

    __slots__ = (
        "_corrected",
        "_correction",
        "_expected",
        "_filled",
        "_layers",
        "_logs",
        "_mean",
        "_part",
        "_present",
        "_ratio_range",
        "_seen",
        "_weights",
        "missing",
    )

    def __init__(self, mean: Array, precision: Array, ratio_range: Array, layers: Layers | None = None) -> None:
        self._mean = mean
        self._layers = layers
        self._correction: Correction | None = None
        self._corrected = np.zeros(0, dtype=np.intp)
        self._ratio_range = (float(ratio_range[0]), float(ratio_range[1]))
        self._logs = np.zeros(N_ROWS)
        self._filled = self._present = np.zeros(0, dtype=np.intp)
        self._seen = self._part = self._expected = np.zeros(0)
        self._weights: Array = np.zeros((0, 0))
        self.missing: Rows = np.zeros(N_ROWS, dtype=np.bool_)
        """(104,) rows that are filled in."""
        self.leave_out(self.missing, precision)

    def leave_out(
        self, rows: Rows, precision: Array, electrodes: tuple[int, ...] = (), noise: Array | None = None
    ) -> None:
        """Fill these rows in from the next frame on, and weigh noisy ones; under a millisecond.

        Args:
            rows: (104,) the missing ones; none is allowed.
            precision: (104, 104) P, all noise in it.
            electrodes: Those that are gone altogether: all of their rows must be among the missing ones.
            noise: (104,) variance by which rows are weighed, 0 for those that are taken as they are; None weighs none.
        """
        self.missing = rows.copy()
        weighed = np.zeros_like(rows) if noise is None else ~rows & (noise > 0.0)
        gone, noisy = np.flatnonzero(rows), np.flatnonzero(weighed)
        self._filled, self._present = np.flatnonzero(rows | weighed), np.flatnonzero(~rows)
        weights = np.zeros((N_ROWS, len(self._present)))
        weights[gone] = missing_weights(precision, rows)
        if noise is not None and len(noisy):
            # What P says of the present rows once the missing ones are filled in by the line above.
            left = precision[np.ix_(noisy, self._present)] - precision[np.ix_(noisy, gone)] @ weights[gone]
            weights[noisy] = noise[noisy, None] * left
            weights[noisy, np.searchsorted(self._present, noisy)] -= 1.0
        self._weights = weights[self._filled]
        self._seen, self._part = np.zeros(len(self._present)), np.zeros(len(self._filled))
        self._expected = self._mean[self._filled]
        self._correction = None
        if self._layers is not None and electrodes:
            own = np.flatnonzero(rows_of(electrodes))
            self._corrected = np.searchsorted(self._filled, own)
            self._correction = Correction(self._layers, own, electrodes)

    @property
    def idle(self) -> bool:
        """Whether there is nothing to fill in."""
        return not len(self._filled)

    def fill(self, change: npt.NDArray[np.float32], predicted: npt.NDArray[np.float32] = UNPREDICTED) -> None:
        """Overwrite the missing rows by their estimates from the others, and the noisy ones by weighted means.

        Args:
            change: (104,) dV.
            predicted: (104,) log(V_pred / V0) of the cloud in use; zeros without one.
        """
        if not len(self._filled):
            return
        log_of_change(change, self._ratio_range, out=self._logs)
        np.subtract(self._logs, self._mean, out=self._logs)
        np.take(self._logs, self._present, out=self._seen, mode="clip")
        np.matmul(self._weights, self._seen, out=self._part)
        np.negative(self._part, out=self._part)
        if self._correction is not None:
            self._logs[self._filled] = self._part
            self._part[self._corrected] += self._correction.of(self._logs, predicted)
        np.add(self._expected, self._part, out=self._part)
        change_of_log(self._part, self._ratio_range, out=self._part)
        np.add(self._part, 1.0, out=self._part)  # V / V0, so that dV is 0 or at least 1e-16 as everywhere else
        change[self._filled] = np.subtract(self._part, 1.0, out=self._part)

    def filled(self, changes: Array) -> Array:
        """Return (n, 104) dV with the rows filled in as :meth:`fill` does, without the small network's correction."""
        if self.idle:
            return changes
        logs = log_of_change(changes, self._ratio_range) - self._mean
        found = np.array(changes, dtype=np.float64)
        part = self._expected - product(logs[:, self._present], self._weights.T)
        found[:, self._filled] = change_of_log(part, self._ratio_range)
        return found


def without_rows(matrix: npt.NDArray[np.float32], inverse: Array, rows: Rows) -> npt.NDArray[np.float32]:
    """Return a projection as if some rows had never been measured; their columns are 0.

    Args:
        matrix: (n, 104) M = J^T K.
        inverse: (104, 104) K = (J J^T + tau I)^-1.
        rows: (104,) the missing ones.
    """
    gone = np.flatnonzero(rows)
    if not len(gone):
        return matrix
    back = np.linalg.solve(inverse[np.ix_(gone, gone)], inverse[gone])
    found = matrix - product(matrix[:, gone].astype(np.float64), back)
    found[:, gone] = 0.0
    return np.ascontiguousarray(found, dtype=np.float32)
