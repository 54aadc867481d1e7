"""What a set of touched units costs before anything is measured, to be added to its chi-squared.

Units side by side are one touch. A set that differs from where the search began pays for each unit in which it does:
what the network, or the last frame, says is evidence too.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.verification.prior import Prior

OTHERS: Final = (0.3, 3.0)
"""Contrasts that are tried besides the usual one, in the wider search."""

LOG_SD: Final = 1.2
"""Standard deviation of a contrast's logarithm about the usual one, or about one that is tried."""

FREE: Final = 2.0
"""What a contrast that is fitted costs, beside its prior."""

BESIDE: Final = 1.0
"""What a unit costs beside another one that is touched: it is part of the same touch."""

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
        self._started = np.zeros((0, len(row)), dtype=np.bool_)

    @property
    def starts(self) -> list[Index]:
        """Return the units of each start."""
        return [np.flatnonzero(one) for one in self._started]

    def begin(self, starts: Sequence[Index]) -> None:
        """Say where the search begins."""
        self._started = np.zeros((len(starts), len(self._beside)), dtype=np.bool_)
        for own, units in zip(self._started, starts, strict=True):
            own[units] = True

    def of(self, units: Index, contrasts: Array) -> float:
        """Return what a set costs: its touches, its contrasts, and what starts did not say."""
        usual = np.log(self._usual)
        away = np.unique(np.log(contrasts[contrasts != self._usual]))
        least = np.minimum.reduce([np.square((away - one) / LOG_SD) for one in (usual, *np.log(OTHERS))])
        pieces = self.pieces(units)
        own = self._prior.cost(pieces) + BESIDE * (len(units) - pieces) + AGAINST * self._against(units)
        return own + FREE * len(away) + float(least.sum())

    def more(self, units: Index, without: Index) -> Array:
        """Return (n,) what each of some units adds to the price of a set that does not hold it."""
        beside = self._beside[np.ix_(units, without)].any(axis=1)
        apart = self._apart(without)
        further = np.zeros(len(units))
        if apart.size:
            one_more = np.where(self._started[:, units], -1, 1)
            further = (apart[:, None] + one_more).min(axis=0) - apart.min()
        return np.asarray(np.where(beside, BESIDE, self._prior.cost(1)) + AGAINST * further)

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

    def _apart(self, units: Index) -> Index:
        """Return (starts,) in how many units a set differs from each start."""
        own = np.zeros(self._started.shape[1], dtype=np.bool_)
        own[units] = True
        return np.asarray((self._started ^ own).sum(axis=1))

    def _against(self, units: Index) -> int:
        """Return in how many units a set differs from the start that is nearest to it."""
        apart = self._apart(units)
        return int(apart.min()) if apart.size else 0
