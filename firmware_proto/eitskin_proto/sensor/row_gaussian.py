"""Predicts missing rows from the others: a sheet's rows are nearly Gaussian in l = log(V / V0).

With P the precision (inverse covariance) and y = P (l - mean), the rows m that are missing have ::

    conditional mean        l_m - P_mm^-1 y_m  =  mean_m - W (l_o - mean_o),      W = P_mm^-1 P_mo
    conditional covariance  P_mm^-1

with anything at all in l_m for the first. Nothing of the block of the other rows o is ever inverted. Training fits the
Gaussian and fills rows in with it, in NumPy and in torch; the runtime fills in the same rows from a bundle's. All of
them use this module.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ELECTRODES, TABLE

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.bool_]

RATIO_RANGE: Final = (1e-2, 8.0)
"""V / V0 is cut off here before its logarithm: noise can take a weak row through zero, no touch takes one beyond."""

HIGHEST_LOG: Final = 50.0
"""A logarithm beyond it is as good as infinite, and expm1 of it would overflow before it is cut off."""


@dataclass(frozen=True, slots=True)
class RowGaussian:
    """The Gaussian of l = log(V / V0).

    Args:
        mean: (104,)
        covariance: (104, 104)
    """

    mean: Array
    covariance: Array

    def precision(self) -> Array:
        """Return (104, 104) P."""
        return precision_of(self.covariance)


def rows_of(electrodes: tuple[int, ...]) -> Rows:
    """Return (104,) which rows drive or measure at any of these electrodes."""
    ends = np.concatenate([TABLE, (TABLE + 1) % N_ELECTRODES], axis=1)
    return np.asarray(np.isin(ends, electrodes).any(axis=1))


def precision_of(covariance: Array) -> Array:
    """Return the inverse of a covariance, symmetric to the last digit."""
    found = _inverse(covariance)
    return np.asarray((found + found.T) / 2.0)


def _inverse(covariance: Array) -> Array:
    """Return the inverse of a covariance by halves of its Cholesky factor, for which BLAS takes one thread.

    A runtime takes a new reference between two frames, and its host's BLAS may have threads that wait for a core.
    """
    half = len(covariance) // 2
    try:
        lower = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.inv(covariance))
    first, second = np.linalg.inv(lower[:half, :half]), np.linalg.inv(lower[half:, half:])
    corner = -(second @ lower[half:, :half]) @ first
    across = corner.T @ second
    return np.block([[first.T @ first + corner.T @ corner, across], [across.T, second.T @ second]])


def missing_weights(precision: Array, missing: Rows) -> Array:
    """Return W = P_mm^-1 P_mo, (missing, others): minus the regression of the missing rows on the others.

    Args:
        precision: (104, 104) P.
        missing: (104,) which rows are missing.
    """
    inner = precision[np.ix_(missing, missing)]
    return np.asarray(np.linalg.solve(inner, precision[np.ix_(missing, ~missing)]), dtype=np.float64)


def missing_spread(precision: Array, missing: Rows) -> Array:
    """Return the standard deviation that the others leave to each missing row."""
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(precision[np.ix_(missing, missing)]))))


def log_of_ratio(voltages: npt.NDArray[np.floating], reference: npt.NDArray[np.floating]) -> Array:
    """Return l = log(V / V0), with V / V0 cut off as :func:`log_of_change` does: no row is lost that turns its sign.

    Args:
        voltages: (..., rows) V.
        reference: (rows,) or (..., rows) V0, none of them 0.
    """
    return np.asarray(np.log(np.clip(np.asarray(voltages, dtype=np.float64) / reference, *RATIO_RANGE)))


def log_of_change(
    change: npt.NDArray[np.floating], ratio_range: tuple[float, float] = RATIO_RANGE, out: Array | None = None
) -> Array:
    """Return l = log(1 + dV), with 1 + dV cut off.

    Args:
        change: (..., rows) dV.
        ratio_range: Where V / V0 is cut off.
        out: Where to write, without another array: single precision is then cut off in single precision. None makes a
            new array, in double precision throughout.
    """
    low, high = ratio_range
    if out is None:
        change = out = np.array(change, dtype=np.float64)
    np.clip(change, low - 1.0, high - 1.0, out=out)
    return np.log1p(out, out=out)


def change_of_log(logs: Array, ratio_range: tuple[float, float] = RATIO_RANGE, out: Array | None = None) -> Array:
    """Return dV = exp(l) - 1, with 1 + dV cut off as in :func:`log_of_change`.

    Args:
        logs: (..., rows) l.
        ratio_range: Where V / V0 is cut off.
        out: Where to write, ``logs`` itself if wanted; None makes a new array.
    """
    low, high = ratio_range
    change = np.empty(logs.shape) if out is None else out
    np.minimum(logs, HIGHEST_LOG, out=change)
    np.expm1(change, out=change)
    return np.clip(change, low - 1.0, high - 1.0, out=change)
