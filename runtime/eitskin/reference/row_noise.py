"""Sorts the rows of a reference by their noise: used as measured, weighted, or filled in like missing ones.

The reference is a mean of many frames, so it knows how much each row of a resting sheet varies. Noise that is the same
in all rows, as an amplifier's is, drowns the weakest, which are 500 times smaller than the strongest: dV = V / V0 - 1
of such a row is noise divided by nearly nothing. With sigma = spread of a single frame / |V0| of a row ::

    sigma <= 0.03                                 as measured: a network learned with such noise
    0.03 < sigma <= 0.3                           weighed: what is expected of log(V / V0) from its own reading, with
                                                  that noise, and from all other rows
    sigma > 0.3, or |V0| < 1e-4 of the largest    lost: filled in from the others alone, like a failed electrode's

Above 0.3 a reading is within 3.3 standard deviations of zero, so its logarithm is meaningless. The weighing is the
Gaussian's of :mod:`eitskin.health.imputation`; a bundle without ``consistency.npz`` has none, and lost rows then have
dV = 0. Both bounds were chosen on simulated sheets (``docs/results/robustness.md`` shows their gain); any values from
0.01 to 0.06 and from 0.2 to 0.5 are equal within 0.01 of CC. The gate's noisy rows stay as they are measured, since its
threshold follows the noise (:mod:`eitskin.health.gate_without_rows`).
"""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.normalise import weak_rows

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.bool_]

WEIGHED_SPREAD: Final = 0.03
"""Ten times the noise at 50 dB."""

LOST_SPREAD: Final = 0.3

SMALLEST_SPREAD: Final = 5e-4
"""A recording or a simulation without noise has none."""


def relative_spread(reference_V: Array, spread_V: Array) -> Array:
    """Return (104,) sigma, at least ``SMALLEST_SPREAD``, and 1 in rows that vary by more than they read.

    Args:
        reference_V: (104,) V.
        spread_V: (104,) V, standard deviation of a single frame.
    """
    sigma = np.maximum(spread_V / np.maximum(np.abs(reference_V), 1e-30), SMALLEST_SPREAD)
    return np.where(np.isfinite(sigma) & (sigma < 1.0), sigma, 1.0)


def with_rounding(spread_V: Array, step_V: float) -> Array:
    """Return (104,) V, the standard deviation of a single frame, rounding included.

    Args:
        spread_V: (104,) V, that of the reference's frames; none where all were the same count.
        step_V: V of a count.
    """
    return np.hypot(spread_V, step_V / math.sqrt(12.0))


def lost_rows(reference_V: Array, spread_V: Array) -> Rows:
    """Return (104,) which rows carry nothing.

    Args:
        reference_V: (104,) V.
        spread_V: (104,) V, standard deviation of a single frame.

    Raises:
        ValueError: No row has a voltage.
    """
    return np.asarray(weak_rows(reference_V) | (relative_spread(reference_V, spread_V) > LOST_SPREAD))


def weighed_rows(reference_V: Array, spread_V: Array) -> Rows:
    """Return (104,) which rows are weighed by their noise; lost ones are not among them."""
    sigma = relative_spread(reference_V, spread_V)
    return np.asarray((sigma > WEIGHED_SPREAD) & ~lost_rows(reference_V, spread_V))
