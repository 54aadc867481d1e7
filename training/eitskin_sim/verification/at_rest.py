"""Learns from untouched frames how the sheet differs from its model.

With r the residual of their mean, N its noise, and C the covariance of the model's error::

    s^2      max(1, r^T (C + N)^-1 r / rows)         a larger error than assumed, by a common factor
    beside   C' (C' + N)^-1 r                        estimated error, C' = s^2 C
    left     C' - C' (C' + N)^-1 C'                  its remaining covariance

A touch changes the error, because the same stretch has another effect where the current differs. To first order the
error is proportional to the voltages, row by row. Beyond that, a part ``CHANGED_BY_TOUCH`` of the model's error stays
unknown, and a part ``ROW_ERROR_BY_TOUCH`` of the error seen in each row.
"""

from dataclasses import dataclass

import numpy as np

from eitskin_sim.arrays import Array
from eitskin_sim.verification import constants as c


@dataclass(frozen=True, slots=True, eq=False)
class AtRest:
    """The findings about an untouched sheet."""

    change: Array
    """(rows,) dV that it read."""
    beside: Array
    """(rows,) dV of it that the model does not say."""
    columns: Array
    """(rows, m) dV that may differ yet, of one standard deviation each."""
    scale: float
    """Times that more was off than was thought, 1 at least."""


def at_rest(change: Array, beside: Array, expected: Array, columns: Array, floor: Array, noise: Array) -> AtRest:
    """Return a sheet's deviation from its model.

    Args:
        change: (rows,) dV that it read.
        beside: (rows,) dV of it that the model does not say.
        expected: (rows,) expected residual dV.
        columns: (rows, m) errors of the model in dV, of one standard deviation each.
        floor: (rows,) additional standard deviation of each row's error.
        noise: (rows, rows) covariance of the measurement.
    """
    unseen = columns @ columns.T
    own, rest = unseen + np.diag(np.square(floor)), beside - expected
    whole = own + noise
    variance = max(1.0, float(rest @ np.linalg.solve(whole, rest)) / len(rest))
    own, whole = variance * own, variance * own + noise
    gain = np.linalg.solve(whole, own).T
    found = expected + gain @ rest
    by_touch = c.MODEL_ERROR_SHARE_OF_TOUCH**2 * variance * unseen + np.diag(np.square(c.ROW_ERROR_BY_TOUCH * found))
    left = own - gain @ own + by_touch
    size, way = np.linalg.eigh((left + left.T) / 2.0)
    kept = size > 1e-12
    return AtRest(change, found, way[:, kept] * np.sqrt(size[kept]), float(np.sqrt(variance)))
