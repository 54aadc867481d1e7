"""Steps from one set of touched units to a better one, on a reduced model, until the frame is explained or time is up.

What :mod:`eitskin_sim.verification.units` says in words.
"""

import time
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.reduced.model import ReducedModel
from eitskin_sim.reduced.state import State, state_of
from eitskin_sim.verification.chi_squared import least_chi_squared
from eitskin_sim.verification.frame import Frame
from eitskin_sim.verification.prior import Prior
from eitskin_sim.verification.sets.contrasts import STEPS, estimated, fitted
from eitskin_sim.verification.sets.exchange import Exchange
from eitskin_sim.verification.sets.price import OTHERS, UnitPrice

CONTENT: Final = 0.05
"""The search ends where p is above."""

MOST_TOUCHED: Final = 20
"""Sets grow no further."""

REACH: Final = 2
"""A unit is moved by at most so many, along and across, before it is moved anywhere."""

FAR: Final = 0.7
"""A unit of another contrast must leave such a part of what one of the usual contrast leaves, to be looked at first."""

_NONE: Final[Index] = np.zeros(0, dtype=np.intp)


class Search:
    """One frame's search.

    Args:
        model: The sheet.
        flat_V: (rows,) V of the flat, untouched one.
        frame: What is to be explained.
        prior: What touches are like.
        contrast: The usual one.
        deadline: What the clock shows when it ends.
        clock: In seconds.
        coarse: The same sheet of a lower rank, for exchanges; None is the model itself.
    """

    def __init__(
        self,
        model: ReducedModel,
        flat_V: Array,
        frame: Frame,
        prior: Prior,
        contrast: float,
        deadline: float,
        clock: Callable[[], float] = time.perf_counter,
        coarse: ReducedModel | None = None,
    ) -> None:
        self._model, self._flat, self._frame, self._prior = model, flat_V, frame, prior
        self._usual, self._deadline, self._clock = contrast, deadline, clock
        self._columns = model.shape[1]
        self._coarse = coarse or model
        self._content = least_chi_squared(CONTENT, len(frame.white))
        self._price = UnitPrice(model.shape, prior, contrast)
        self.evaluations = 0

    def on(self, frame: Frame) -> "Search":
        """Return the same search on the frame with another covariance."""
        found = Search(
            self._model, self._flat, frame, self._prior, self._usual, self._deadline, self._clock, self._coarse
        )
        found.evaluations, found._price = self.evaluations, self._price
        return found

    def best_of(self, sets: Sequence[tuple[Index, Array]]) -> State:
        """Return the best of some sets; none is the untouched sheet."""
        different = {tuple(units.tolist()): (units, contrasts) for units, contrasts in sets}
        self._price.begin([units for units, _ in different.values()])
        states = [self._state(*one) for one in different.values()] or [self._state(_NONE, np.zeros(0))]
        costs = [self._cost(state, self._chi(state)) for state in states]
        return states[int(np.argmin(costs))]

    def fitted(self, state: State) -> int:
        """Return how many contrasts of a set were fitted: one if all have the same that is not the usual one."""
        other = state.contrasts[state.contrasts != self._usual]
        return len(np.unique(other))

    def run(self, start: State) -> State:
        """Return the best set that time allows."""
        if self._satisfied(start) or self._late():
            return start
        best = self._fitted(start, common=True) if len(start.units) else start
        best = best if self._explained(best) else self._of_either_sign(start)
        for contrast in self._levels():
            if self._explained(best) or self._late():
                return best
            best = self._better(best, self._exchanged(best, contrast))
            if not self._explained(best):
                best = self._better(best, self._contrasts_fitted(best))
        for other in (self._from_nothing, self._refitted):
            if self._explained(best) or self._late():
                break
            best = self._better(best, other(best))
        return best

    def _of_either_sign(self, start: State) -> State:
        """Return the units of a set with the contrasts that the frame gives them, if that explains it."""
        if not len(start.units):
            return start
        contrasts = estimated(self._frame, self._flat, state_of(self._coarse, start.units, start.contrasts))
        if np.all(contrasts > 1.0):
            return start
        # Of one sign, one contrast for all: with one for each, a wrong set may explain the frame.
        found = self._fitted(self._state(start.units, contrasts), common=bool(np.all(contrasts < 1.0)))
        return self._descended(found) if self._explained(found) else start  # without units that it does not need

    def _levels(self) -> list[float]:
        """Return contrasts to search with: another than the usual one first where one unit of it explains far more."""
        nothing, every = state_of(self._coarse, _NONE, np.zeros(0)), np.arange(self._coarse.n_units)
        levels = (self._usual, *OTHERS)
        chi = [float(self._chis(nothing.with_each(every, one)).min()) for one in levels]
        at = int(np.argmin(chi))
        return [levels[at], self._usual] if chi[at] < FAR * chi[0] else [self._usual]

    def _satisfied(self, state: State) -> bool:
        """Return whether a set explains the frame, and none of its units is one too many."""
        return self._explained(state) and self._removed(state, self._chi(state)) is None

    def _exchanged(self, state: State, contrast: float) -> State:
        """Return a set of units of one contrast, exchanged for others on the coarse model until they explain it."""
        nothing = [] if contrast == self._usual else [_NONE]

        def explains(units: Index, contrast: float) -> bool:
            return self._explained(self._state(units, np.full(len(units), contrast)))

        exchange = Exchange(self._coarse, self._flat, self._frame, self._price, self._content, explains, self._late)
        units = exchange.improved([state.units, *self._price.starts, *nothing], contrast)
        self.evaluations += exchange.evaluations
        found = self._state(units, np.full(len(units), contrast))
        return self._descended(self._better(state, found), (contrast,))

    def _late(self) -> bool:
        return self._clock() >= self._deadline

    def _state(self, units: Index, contrasts: Array) -> State:
        self.evaluations += 1
        return state_of(self._model, units, contrasts)

    def _chi(self, state: State) -> float:
        return float(self._frame.chi_squared(state.volts / self._flat))

    def _chis(self, volts: Array) -> Array:
        self.evaluations += len(volts)
        return self._frame.chi_squared(volts / self._flat)

    def _explained(self, state: State) -> bool:
        return self._chi(state) <= self._content

    def _cost(self, state: State, chi: float, inflation: float = 1.0) -> float:
        return chi / inflation + self._price.of(state.units, state.contrasts)

    def _inflation(self, chi: float) -> float:
        return max(chi / len(self._frame.white), 1.0)

    def _better(self, first: State, second: State) -> State:
        """Return the cheaper of two sets, at the inflation of the better explained one."""
        one, two = self._chi(first), self._chi(second)
        inflation = self._inflation(min(one, two))
        return second if self._cost(second, two, inflation) < self._cost(first, one, inflation) else first

    def _descended(self, state: State, contrasts: tuple[float, ...] = ()) -> State:
        """Return a set that no step improves: units removed, added, and moved, the best step first."""
        contrasts = contrasts or (self._usual,)
        while not self._late():
            chi = self._chi(state)
            step = self._removed(state, chi)
            if step is None and chi <= self._content:
                return state
            step = step or self._added(state, chi, contrasts) or self._moved(state, chi, contrasts, REACH)
            step = step or (self._moved(state, chi, contrasts, None) if chi > self._content else None)
            if step is None:
                return state
            state = step
        return state

    def _removed(self, state: State, chi: float) -> State | None:
        if not len(state.units):
            return None
        chis, inflation = self._chis(state.without_each()), self._inflation(chi)
        saved = np.array(
            [self._price.more(state.units[i : i + 1], np.delete(state.units, i))[0] for i in range(len(chis))]
        )
        gain = (chi - chis) / inflation + saved
        best = int(np.argmax(gain))
        return state.without(best) if gain[best] > 0.0 else None

    def _added(self, state: State, chi: float, contrasts: tuple[float, ...]) -> State | None:
        if len(state.units) >= MOST_TOUCHED:
            return None
        unit, contrast, best = self._best_addition(state, contrasts, None)
        if (chi - best) / self._inflation(chi) <= self._price.more(np.array([unit]), state.units)[0]:
            return None
        return self._state(np.append(state.units, unit), np.append(state.contrasts, contrast))

    def _best_addition(
        self, state: State, contrasts: tuple[float, ...], among: Index | None
    ) -> tuple[int, float, float]:
        """Return the unit, its contrast and the chi-squared of the best set with one unit more."""
        free = np.setdiff1d(np.arange(self._model.n_units) if among is None else among, state.units)
        best = (-1, contrasts[0], np.inf)
        if free.size:
            for contrast in contrasts:
                chis = self._chis(state.with_each(free, contrast))
                at = int(np.argmin(chis))
                if chis[at] < best[2]:
                    best = (int(free[at]), contrast, float(chis[at]))
        return best

    def _moved(self, state: State, chi: float, contrasts: tuple[float, ...], reach: int | None) -> State | None:
        """Return the set with one unit elsewhere, within reach or anywhere: the first that explains it, or the best."""
        best: tuple[float, State, int, float] | None = None
        order: list[int] = np.argsort(self._chis(state.without_each())).tolist() if len(state.units) else []
        for number in order:
            if self._late():
                break
            rest = state.without(number)
            among = None if reach is None else self._around(int(state.units[number]), reach)
            unit, contrast, found = self._best_addition(rest, contrasts, among)
            if best is None or found < best[0]:
                best = (found, rest, unit, contrast)
            if found <= self._content:
                break
        if best is None or best[2] < 0:
            return None
        found_state = self._state(np.append(best[1].units, best[2]), np.append(best[1].contrasts, best[3]))
        inflation = self._inflation(best[0])
        gain = self._cost(state, chi, inflation) - self._cost(found_state, best[0], inflation)
        return found_state if gain > 1e-6 else None

    def _around(self, unit: int, reach: int) -> Index:
        row, column = np.divmod(np.arange(self._model.n_units), self._columns)
        own_row, own_column = divmod(unit, self._columns)
        near = np.maximum(np.abs(row - own_row), np.abs(column - own_column)) <= reach
        return np.flatnonzero(near)

    def _contrasts_fitted(self, state: State) -> State:
        """Return a set with one contrast for all fitted, units changed with it, and then one for each."""
        if not len(state.units):
            return state
        common = self._fitted(state, common=True)
        again = common
        if common is not state and not self._explained(common):
            again = self._exchanged(common, float(common.contrasts[0]))
        if len(again.units) and not self._late() and not self._explained(again):
            again = self._better(again, self._fitted(again, common=False))
        return self._better(state, again)

    def _fitted(self, state: State, common: bool) -> State:
        """Return a set with its contrasts fitted."""
        self.evaluations += STEPS
        return fitted(self._frame, self._flat, state, common=common, late=self._late)

    def _from_nothing(self, best: State) -> State:
        """Return a set that is built up from nothing with contrasts of either sign."""
        found = self._descended(self._state(_NONE, np.zeros(0)), (self._usual, *OTHERS))
        if len(found.units) and not self._late() and not self._explained(found):
            found = self._better(found, self._fitted(found, common=False))
        return found

    def _refitted(self, best: State) -> State:
        """Return the best set with steps of either sign, and its contrasts fitted anew."""
        found = self._descended(best, (self._usual, *OTHERS))
        if len(found.units) and not self._late() and not self._explained(found):
            found = self._better(found, self._fitted(found, common=False))
            found = self._better(found, self._descended(found, (self._usual, *OTHERS)))
        return found
