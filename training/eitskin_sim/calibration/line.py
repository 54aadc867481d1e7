"""The straight line of a reference: readings = factor * model + offset, before any other parameter is sought.

A front end with an offset of all rows, or with unequal paths to its amplifier, may be off by more than most of the
signal. No search from an offset of zero finds it. The line is fitted to relative errors, least in their absolute sum,
so that small rows count and a wrong row does not. The offset is used only where it explains the rows far better than a
factor alone.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_sim.arrays import Array

ROUNDS: Final = 50
"""Of weighted least squares, which settle on the least absolute sum."""

MIN_IMPROVEMENT: Final = 2.0
"""By this factor the line's median error must be below the factor's."""


@dataclass(frozen=True, slots=True)
class Line:
    """Readings as a straight line of the model's."""

    factor: float
    """V of a reading per V of the model; negative where rows have the other sign."""
    offset_V: float
    """Of all readings; 0 where a factor alone explains them as well."""


def straight_line(reading_V: Array, model_V: Array) -> Line:
    """Return the straight line of readings (rows,) by the model's voltages (rows,) under 1 A."""
    ratio = reading_V / model_V
    (factor,) = _least_absolute(np.ones((len(ratio), 1)), ratio)
    slope, offset = _least_absolute(np.stack([np.ones(len(ratio)), 1.0 / model_V], axis=-1), ratio)
    alone, together = (
        float(np.median(np.abs(fitted / reading_V - 1.0))) for fitted in (factor * model_V, slope * model_V + offset)
    )
    return Line(slope, offset) if MIN_IMPROVEMENT * together < alone else Line(factor, 0.0)


def _least_absolute(columns: Array, values: Array) -> list[float]:
    """Return the coefficients of least absolute error."""
    weights = np.ones(len(values))
    for _ in range(ROUNDS):
        root = np.sqrt(weights)[:, None]
        found = np.linalg.lstsq(root * columns, root[:, 0] * values, rcond=None)[0]
        error = np.abs(values - columns @ found)
        weights = 1.0 / (error + 1e-3 * error.mean() + 1e-300)
    return [float(one) for one in found]
