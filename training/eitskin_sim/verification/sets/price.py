"""What a set of touched units costs before anything is measured, to be added to its chi-squared.

Units side by side are one touch. A set that differs from where the search began pays for each unit in which it does:
what the network, or the last frame, says is evidence too.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.verification.prior import Prior

Bits = npt.NDArray[np.bool_]

OTHERS: Final = (0.3, 3.0)
"""Contrasts that are tried besides the usual one, in the wider search."""

LOG_SD: Final = 1.2
"""Standard deviation of a contrast's logarithm about the usual one, or about one that is tried."""

FREE: Final = 2.0
"""What a contrast that is fitted costs, beside its prior."""

BESIDE: Final = 1.0
"""What a unit costs beside another one that is touched: it is part of the same touch."""

SURE: Final = (0.9, 0.98)
"""Heights above which a map is sure of a unit."""

LEAST: Final = 0.003
"""No map is surer than that of a unit: sheets differ from those that the network has learned from."""

AGAINST: Final = 6.0
"""What each unit costs in which a set differs from the nearest start: a network errs in one unit of some hundreds."""


class UnitPrice:
    """Prices of sets.

    Args:
        shape: Rows and columns of units.
        prior: What touches are like.
        usual: The usual contrast.
    """

    def __init__(self, shape: tuple[int, int], prior: Prior, usual: float) -> None:
        self._prior, self._usual = prior, usual
        row, column = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
        self._beside = np.abs(row[:, None] - row) + np.abs(column[:, None] - column) == 1
        self.begin([])

    @property
    def starts(self) -> list[Index]:
        """Return the units of each start."""
        return [np.flatnonzero(one) for one in self._started]

    @property
    def sure(self) -> list[Index]:
        """Return the units that a map is sure of, at some heights: further starts, for where it shows too many."""
        return [] if self._heights is None else [np.flatnonzero(self._heights > one) for one in SURE]

    @property
    def in_doubt(self) -> bool:
        """Return whether it is known which units are in doubt."""
        return self._heights is not None

    @property
    def doubts(self) -> Array:
        """Return (units,) what it costs to differ in each: those in doubt cost least."""
        return np.asarray(self._weights[:1].sum(axis=0))

    def begin(self, starts: Sequence[Index], heights: Array | None = None) -> None:
        """Say where the search begins.

        Args:
            starts: Units of each.
            heights: (units,) of a map, how likely each is touched; None is not known. They count as a start.
        """
        self._heights = heights
        self._started = np.zeros((len(starts), len(self._beside)), dtype=np.bool_)
        for own, units in zip(self._started, starts, strict=True):
            own[units] = True
        self._nearest, self._weights = self._started, np.full(self._started.shape, AGAINST)
        if heights is not None:
            sure = np.clip(heights, LEAST, 1.0 - LEAST)
            odds = 2.0 * np.abs(np.log(sure / (1.0 - sure)))
            self._nearest = np.vstack([heights >= 0.5, self._started])
            self._weights = np.vstack([odds, self._weights])

    def of(self, units: Index, contrasts: Array) -> float:
        """Return what a set costs: its touches, its contrasts, and what starts did not say."""
        usual = np.log(self._usual)
        away = np.unique(np.log(contrasts[contrasts != self._usual]))
        least = np.minimum.reduce([np.square((away - one) / LOG_SD) for one in (usual, *np.log(OTHERS))])
        pieces = self.pieces(units)
        own = self._prior.cost(pieces) + BESIDE * (len(units) - pieces) + self._against(units)
        return own + FREE * len(away) + float(least.sum())

    def of_bits(self, touched: Bits) -> float:
        """Return what a set of units of the usual contrast costs, as (units,) truth values."""
        units = np.flatnonzero(touched)
        return self.of(units, np.full(len(units), self._usual))

    def flips(self, touched: Bits) -> Array:
        """Return (units,) what putting in each unit that a set does not hold adds to its price, or taking out one."""
        own = np.where(self._beside[:, touched].any(axis=1), BESIDE, self._prior.cost(1))
        further = np.zeros(len(own))
        if len(self._nearest):
            differs = self._nearest ^ touched
            apart = (differs * self._weights).sum(axis=1)
            changed = apart[:, None] + np.where(differs, -self._weights, self._weights)
            further = changed.min(axis=0) - apart.min()
        return np.asarray(np.where(touched, -own, own) + further)

    def more(self, units: Index, without: Index) -> Array:
        """Return (n,) what each of some units adds to the price of a set that does not hold it."""
        touched = np.zeros(len(self._beside), dtype=np.bool_)
        touched[without] = True
        return self.flips(touched)[units]

    def pieces(self, units: Index) -> int:
        """Return how many touches a set of units is: those side by side are one."""
        left, pieces = set(units.tolist()), 0
        while left:
            pieces += 1
            reached = [left.pop()]
            while reached:
                own = reached.pop()
                near = {one for one in left if self._beside[own, one]}
                left -= near
                reached += near
        return pieces

    def _against(self, units: Index) -> float:
        """Return what it costs to differ from the start that is nearest, or from the heights."""
        touched = np.zeros(len(self._beside), dtype=np.bool_)
        touched[units] = True
        apart = ((self._nearest ^ touched) * self._weights).sum(axis=1)
        return float(apart.min()) if apart.size else 0.0
