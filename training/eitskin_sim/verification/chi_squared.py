"""From a sum of squares to how surprising it is, and whether such statements keep their word.

A right model leaves a chi-squared near its number of degrees of freedom n, give or take sqrt(2 n). The p-value is the
chance that a right model leaves this much or more: among right answers it is uniform, one in a hundred below 0.01.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import special

Array = npt.NDArray[np.float64]

LEVEL: Final = 0.01
"""A verdict whose p-value is below is flagged."""


def p_value(chi_squared: float, degrees_of_freedom: int) -> float:
    """Return the chance of so large a chi-squared or a larger one under a right model (``scipy.stats.chi2.sf``).

    Raises:
        ValueError: There are no degrees of freedom.
    """
    if degrees_of_freedom < 1:
        raise ValueError(f"{degrees_of_freedom} degrees of freedom: more is fitted than there are rows")
    return float(special.chdtrc(degrees_of_freedom, max(chi_squared, 0.0)))


@dataclass(frozen=True, slots=True)
class Found:
    """How often p was below a level."""

    stated: float
    """The level."""
    found: float
    """Share of p-values below it; the level itself if p keeps its word."""
    error: float
    """Standard error of the share, of as many right answers."""


def calibration(p_values: Sequence[float] | Array, levels: Sequence[float]) -> list[Found]:
    """Return, for each level, how often p was below it.

    Raises:
        ValueError: There are no p-values.
    """
    p = np.asarray(p_values, dtype=np.float64)
    if not p.size:
        raise ValueError("no p-values; expected at least one")
    return [Found(one, float(np.mean(p < one)), float(np.sqrt(one * (1.0 - one) / p.size))) for one in levels]
