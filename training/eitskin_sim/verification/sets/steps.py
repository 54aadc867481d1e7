"""Steps of one unit: put in, taken out, moved, the best one first, on the whole model."""

from typing import Final

import numpy as np

from eitskin_sim.fem.mesh import Index
from eitskin_sim.reduced.state import State
from eitskin_sim.verification.sets.judge import Judge

MOST_TOUCHED: Final = 20
"""Sets grow no further."""

REACH: Final = 2
"""A unit is moved by at most so many, along and across, before it is moved anywhere."""


class Steps:
    """Steps on one frame, judged by its judge."""

    def __init__(self, judge: Judge) -> None:
        self._judge, self._columns = judge, judge.model.shape[1]

    def descended(self, state: State, contrasts: tuple[float, ...] = ()) -> State:
        """Return a set that no step improves: units removed, added, and moved, the best step first."""
        contrasts = contrasts or (self._judge.usual,)
        while not self._judge.late():
            chi = self._judge.chi(state)
            step = self.removed(state, chi)
            if step is None and chi <= self._judge.content:
                return state
            step = step or self._added(state, chi, contrasts) or self._moved(state, chi, contrasts, REACH)
            step = step or (self._moved(state, chi, contrasts, None) if chi > self._judge.content else None)
            if step is None:
                return state
            state = step
        return state

    def removed(self, state: State, chi: float) -> State | None:
        """Return the set without the unit that is one too many, None where none is."""
        if not len(state.units):
            return None
        chis, inflation = self._judge.chis(state.without_each()), self._judge.inflation(chi)
        saved = np.array(
            [self._judge.price.more(state.units[i : i + 1], np.delete(state.units, i))[0] for i in range(len(chis))]
        )
        gain = (chi - chis) / inflation + saved
        best = int(np.argmax(gain))
        return state.without(best) if gain[best] > 0.0 else None

    def _added(self, state: State, chi: float, contrasts: tuple[float, ...]) -> State | None:
        if len(state.units) >= MOST_TOUCHED:
            return None
        unit, contrast, best = self._best_addition(state, contrasts, None)
        if (chi - best) / self._judge.inflation(chi) <= self._judge.price.more(np.array([unit]), state.units)[0]:
            return None
        return self._judge.state(np.append(state.units, unit), np.append(state.contrasts, contrast))

    def _best_addition(
        self, state: State, contrasts: tuple[float, ...], among: Index | None
    ) -> tuple[int, float, float]:
        """Return the unit, its contrast and the chi-squared of the best set with one unit more."""
        free = np.setdiff1d(np.arange(self._judge.model.n_units) if among is None else among, state.units)
        best = (-1, contrasts[0], np.inf)
        if free.size:
            for contrast in contrasts:
                chis = self._judge.chis(state.with_each(free, contrast))
                at = int(np.argmin(chis))
                if chis[at] < best[2]:
                    best = (int(free[at]), contrast, float(chis[at]))
        return best

    def _moved(self, state: State, chi: float, contrasts: tuple[float, ...], reach: int | None) -> State | None:
        """Return the set with one unit elsewhere, within reach or anywhere: the first that explains it, or the best."""
        best: tuple[float, State, int, float] | None = None
        order: list[int] = np.argsort(self._judge.chis(state.without_each())).tolist() if len(state.units) else []
        for number in order:
            if self._judge.late():
                break
            rest = state.without(number)
            among = None if reach is None else self._around(int(state.units[number]), reach)
            unit, contrast, found = self._best_addition(rest, contrasts, among)
            if best is None or found < best[0]:
                best = (found, rest, unit, contrast)
            if found <= self._judge.content:
                break
        if best is None or best[2] < 0:
            return None
        found_state = self._judge.state(np.append(best[1].units, best[2]), np.append(best[1].contrasts, best[3]))
        inflation = self._judge.inflation(best[0])
        gain = self._judge.cost(state, chi, inflation) - self._judge.cost(found_state, best[0], inflation)
        return found_state if gain > 1e-6 else None

    def _around(self, unit: int, reach: int) -> Index:
        row, column = np.divmod(np.arange(self._judge.model.n_units), self._columns)
        own_row, own_column = divmod(unit, self._columns)
        near = np.maximum(np.abs(row - own_row), np.abs(column - own_column)) <= reach
        return np.flatnonzero(near)
