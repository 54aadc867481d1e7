"""Removes the common drift of a tank's rows since its water was measured, as far as objects cannot cause it.

No object moves all rows alike: rows far from it stay. So with d the relative changes, A from cells to rows::

    d = c + A x          x sparse, by l1 on what is uneven of A and d;          c = mean(d - A x)

and x = 0 where what is uneven of d is no more than rows' noise.
c cannot be told from what the touched cells S make. Its standard error is that of a constant which only counts as far
as it is outside of their span::

    sd(c) = s / |(1 - P_S) 1|          s^2 = |d - c - A x|^2 / (104 - rank - 1)

In 32 simulated tanks without drift c was within 3 sd of 0 in all but three, and within 4 in all; sd was 0.2 % with one
object in it, 1 to 4 % with two, 1 to 24 % with three and 3 to 9 % with four, which leave no row alone.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_proto.sensor.table import N_ROWS
from eitskin_sim.arrays import Array
from eitskin_sim.solvers.operators import SATURATED_CONTRAST
from eitskin_sim.tank.images import signed_l1

SIGNIFICANT_SD: Final = 4.0
"""A common factor is distinguished from objects above this many of its standard errors."""

MIN_COMMON_FACTOR: Final = 0.02
"""Smallest that is taken out, as in a stream."""

MAX_COMMON_FACTOR: Final = 0.5
"""Largest: beyond it is another current, or no tank."""

MIN_DIRECTION_SHARE: Final = 1e-2
"""Directions weaker than this share of the strongest are not what touched cells make."""

NOISY: Final = 1.0 + 5.0 * np.sqrt(2.0 / N_ROWS)
"""Mean square of what is uneven over its noise, up to which nothing stands in the tank: as in a stream."""

BOUND_TOLERANCE: Final = 1e-6
"""A cell so near to 0 or to a bound is not free."""


@dataclass(frozen=True, slots=True)
class Common:
    """The common change of rows."""

    relative: float
    """c."""
    sd: float
    """Of c; infinite where objects can make all of it."""

    @property
    def is_significant(self) -> bool:
        """Whether it is distinguished from the effect of objects."""
        return abs(self.relative) > SIGNIFICANT_SD * self.sd

    @property
    def taken_out(self) -> bool:
        """Whether :meth:`without` takes it out."""
        return self.is_significant and MIN_COMMON_FACTOR <= abs(self.relative) <= MAX_COMMON_FACTOR

    def without(self, change: Array) -> Array:
        """Return (104,) changes without it, or as they are where it is not to be taken out."""
        return (1.0 + change) / (1.0 + self.relative) - 1.0 if self.taken_out else change


def common_factor(operator: Array, change: Array, noise: float) -> Common:
    """Return the common part of (104,) relative changes that objects do not cause.

    Args:
        operator: (104, n) from cells to rows.
        change: (104,) of one frame.
        noise: Standard deviation of its rows.
    """
    uneven, image = change - change.mean(), np.zeros(operator.shape[1])
    if np.mean(uneven**2) > NOISY * noise**2:
        image = signed_l1(operator - operator.mean(axis=0), uneven)
    rest = change - operator @ image
    common = float(rest.mean())
    size = np.abs(image)
    span = _span(operator[:, (size > BOUND_TOLERANCE) & (size < SATURATED_CONTRAST - BOUND_TOLERANCE)])
    ones = np.ones(len(change))
    outside = ones - span @ (span.T @ ones)
    freedom, alone = len(change) - span.shape[1] - 1, float(outside @ outside)
    if freedom < 1 or alone < BOUND_TOLERANCE:
        return Common(common, float("inf"))
    return Common(common, float(np.sqrt(np.sum((rest - common) ** 2) / freedom / alone)))


def _span(columns: Array) -> Array:
    """(rows, k) orthonormal directions that columns make."""
    if not columns.shape[1]:
        return np.zeros((len(columns), 0))
    left, strength, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, strength > MIN_DIRECTION_SHARE * strength[0]])
