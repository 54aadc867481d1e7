"""Units taken out of a set and others put in, one, two or three at a time, until the frame is explained.

Steps of one unit end where two wrong ones hold each other: a unit stands between the two that are touched, or each of a
pair is one place off. So a unit, or two that are near each other, are taken out, and the best one or two of the
places around them are put in. With d_v what unit v alone adds to the whitened voltages of the rest, and r what the rest
leaves, all pairs are judged at once by ::

    |r - d_v - d_w|^2 = |r - d_v|^2 + |r - d_w|^2 - |r|^2 + 2 d_v d_w

which leaves out what v and w do to each other; the best few are then modelled. All units have one contrast here, and
the model may be a coarse one (:meth:`eitskin_sim.reduced.model.ReducedModel.of_rank`): what is found is judged anew.
"""

from collections.abc import Callable, Iterator, Sequence
from heapq import heapify, heappop, heappush
from itertools import combinations
from typing import Final

import numpy as np

from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.reduced.model import ReducedModel
from eitskin_sim.reduced.state import State, state_of
from eitskin_sim.verification.frame import Frame
from eitskin_sim.verification.sets.price import UnitPrice

REACH: Final = 3
"""Units that are put in lie at most so many, along and across, from one that was taken out."""

NEAR: Final = 3
"""Two units that are taken out together are as near."""

TRIED: Final = 8
"""Pairs that are modelled, of those that look best."""

INFLATION: Final = 2.0
"""Gains in chi-squared are divided by it: a model that is not quite the sheet's is not filled with touches."""

KEPT: Final = 4
"""Of each way to put units in, so many of the best are kept to go on from."""


PATIENCE: Final = 12
"""Sets in a row that are gone on from without a cheaper one: then the search ends."""

ALMOST: Final = 3.0
"""A set with up to so many times the chi-squared of one that explains the frame may do so on the whole model."""


class Exchange:
    """Exchanges on one frame.

    Args:
        model: The sheet; a coarse one will do.
        flat_V: (rows,) V of the flat, untouched one.
        frame: What is to be explained.
        price: Of sets.
        content: Chi-squared below which a set explains the frame.
        explains: Says of units of some contrast whether they do on the whole model.
        late: Says when time is up.
    """

    def __init__(
        self,
        model: ReducedModel,
        flat_V: Array,
        frame: Frame,
        price: UnitPrice,
        content: float,
        explains: Callable[[Index, float], bool],
        late: Callable[[], bool],
    ) -> None:
        self._model, self._flat, self._frame, self._price = model, flat_V, frame, price
        self._content, self._explains, self._late = content, explains, late
        row, column = np.divmod(np.arange(model.n_units), model.shape[1])
        self._distance = np.maximum(np.abs(row[:, None] - row), np.abs(column[:, None] - column))
        self.evaluations = 0

    def improved(self, starts: Sequence[Index], contrast: float) -> Index:
        """Return the first set found that explains the frame, or the cheapest until time is up.

        The cheapest set that is known is always the next to go on from: with one unit taken out, or none, and once
        that led nowhere with two.

        Args:
            starts: (k,) units each, where to begin; at least one.
            contrast: Of all units.
        """
        open_ = [(self._cost(self._state(own, contrast)), 0, own) for own in {_key(one) for one in starts}]
        heapify(open_)
        seen, best = {own for _, _, own in open_}, min((cost, own) for cost, _, own in open_)
        idle = 0
        while open_ and idle < PATIENCE and not self._late():
            cost, taken, own = heappop(open_)
            idle += 1
            if taken == 0:
                heappush(open_, (cost, 1, own))
            for chi, more, units in self._children(self._state(own, contrast), contrast, taken):
                key = _key(units)
                if key in seen:
                    continue
                seen.add(key)
                if chi <= ALMOST * self._content and self._explains(units, contrast):
                    return np.array(key, dtype=np.intp)
                if more < best[0]:
                    best, idle = (more, key), 0
                heappush(open_, (more, 0, key))
        return np.array(best[1], dtype=np.intp)

    def _state(self, units: tuple[int, ...], contrast: float) -> State:
        self.evaluations += 1
        return state_of(self._model, np.array(units, dtype=np.intp), np.full(len(units), contrast))

    def _cost(self, state: State) -> float:
        chi = float(self._frame.chi_squared(state.volts / self._flat))
        return chi / INFLATION + self._price.of(state.units, state.contrasts)

    def _children(self, state: State, contrast: float, taken: int) -> Iterator[tuple[float, float, Index]]:
        """Yield chi-squared, cost and units of the sets that one step leads to."""
        units = state.units
        out: list[tuple[int, ...]] = [(), *((number,) for number in range(len(units)))]
        if taken:
            out = [pair for pair in combinations(range(len(units)), 2) if self._near(units[list(pair)])]
        for numbers in out:
            if self._late():
                return
            yield from self._exchanged(state, contrast, numbers)

    def _near(self, pair: Index) -> bool:
        return bool(self._distance[pair[0], pair[1]] <= NEAR)

    def _exchanged(
        self, state: State, contrast: float, numbers: tuple[int, ...]
    ) -> Iterator[tuple[float, float, Index]]:
        """Yield chi-squared, cost and units of sets with some units taken out, and none, one or two others put in."""
        rest, gone = state, state.units[list(numbers)]
        for number in sorted(numbers, reverse=True):
            rest = rest.without(number)
        near = (
            (self._distance[gone] <= REACH).any(axis=0) if len(gone) else np.ones(self._model.n_units, dtype=np.bool_)
        )
        near[rest.units] = False
        places = np.flatnonzero(near)
        beside = rest.beside(places, contrast)
        left = self._frame.whiten(self._frame.ratio - rest.volts / self._flat)
        added = self._frame.whiten((beside.one() - rest.volts) / self._flat)
        base, more = self._price.of(rest.units, rest.contrasts), self._price.more(places, rest.units)
        bare = float(left @ left)
        yield bare, bare / INFLATION + base, rest.units
        chi = np.einsum("nr,nr->n", left - added, left - added)
        own = chi / INFLATION + more
        for at in np.argsort(own)[:KEPT]:
            yield float(chi[at]), float(own[at]) + base, np.append(rest.units, places[at])
        both = own[:, None] + own + (2.0 * added @ added.T - bare) / INFLATION
        first, second = np.triu_indices(len(places), 1)
        order = np.argpartition(both[first, second], TRIED)[:TRIED] if len(first) > TRIED else np.arange(len(first))
        first, second = first[order], second[order]
        chi = self._frame.chi_squared(beside.two(first, second) / self._flat)
        cost = chi / INFLATION + more[first] + more[second] + base
        for at in np.argsort(cost)[:KEPT]:
            two = places[[first[at], second[at]]]
            yield float(chi[at]), float(cost[at]), np.append(rest.units, two)


def _key(units: Index) -> tuple[int, ...]:
    return tuple(sorted(units.tolist()))
