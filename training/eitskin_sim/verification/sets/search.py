"""From a start to the best set of touched units that time allows, on a reduced model.

What :mod:`eitskin_sim.verification.units` says in words.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.reduced.state import State, state_of
from eitskin_sim.verification.sets.candidates import Bits, Candidates, Free, candidates_of, own_contrasts
from eitskin_sim.verification.sets.contrasts import estimated, refitted
from eitskin_sim.verification.sets.exchange import Exchange
from eitskin_sim.verification.sets.judge import Judge
from eitskin_sim.verification.sets.polish import Polish
from eitskin_sim.verification.sets.price import OTHERS
from eitskin_sim.verification.sets.steps import Steps

WORTH: Final[dict[Free, float]] = {"none": 1.0, "common": 1.5, "each": 2.5}
"""By so many times must fitted contrasts explain more than the usual one, to be looked at first."""

UNUSUAL: Final = 2.0
"""Where other contrasts leave so many times less on the start's units, they are looked at before the usual one."""

SURELY: Final = 8.0
"""And where so many times less by one contrast for all, the usual one is not looked at before."""

RATHER: Final = 3.0
"""And where so many times less by a contrast for each, of either sign, those are fitted before all else."""

LOWERED: Final = 0.7
"""A unit is thought of as lowering conductance where its contrast is estimated below."""

FIRST: Final = 10
"""Sets that the usual contrast is given before others are thought of."""

FREE_ALMOST: Final = 40.0
"""A set with up to so many times the chi-squared of one that explains the frame may do so with its contrasts fitted."""

NEARLY: Final = 4.0
"""The same of the coarse model, with contrasts fitted."""

NEAR: Final = 6.0
"""Where the start leaves so many times what explains the frame, another contrast of it may be all that is amiss."""

NONE: Final = 0.25
"""A touch whose contrast's logarithm is nearer to 0 is none, where the others explain the frame without it."""

GROWN: Final = 4
"""Units, at most, of a set that is built from nothing before all else."""

GROWS: Final = 0.5
"""It grows while a unit leaves less than such a part of chi-squared."""

ROUNDS: Final = 3
"""Contrasts are fitted anew so many times, and units exchanged with them."""

SAME: Final = 0.05
"""Contrasts that moved by less, as logarithms, are as before."""

_NONE: Final[Index] = np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, slots=True)
class Level:
    """Contrasts to search with."""

    start: State
    """On the coarse model."""
    free: Free


class Search:
    """One frame's search.

    Args:
        judge: Of sets on the frame.
    """

    def __init__(self, judge: Judge) -> None:
        self._judge, self._steps, self._polish = judge, Steps(judge), Polish(judge)
        self._found: State | None = None
        self._usual: tuple[Exchange, Candidates, Bits] | None = None

    def best_of(self, first: State, sets: Sequence[tuple[Index, Array]], heights: Array | None = None) -> State:
        """Return the best of some sets: the first one, if it explains the frame.

        Args:
            first: A set on the whole model.
            sets: Units and contrasts of further ones.
            heights: (units,) of a map, see :meth:`UnitPrice.begin`.
        """
        judge = self._judge
        every = {_key(first.units, first.contrasts): (first.units, first.contrasts)}
        every |= {_key(*one): one for one in sets}
        judge.evaluations += 1
        judge.price.begin([units for units, _ in every.values()], heights)
        if len(every) == 1 or judge.explained(first):
            return first
        states = [judge.state(*one, coarse=True) for one in every.values()]
        best = int(np.argmin([judge.cost(state, judge.chi(state)) for state in states]))
        return judge.as_whole(states[best]) if best else first

    def fitted(self, state: State) -> int:
        """Return how many contrasts of a set were fitted: one if all have the same that is not the usual one."""
        return own_contrasts(state, self._judge.usual)

    def run(self, start: State) -> State:
        """Return the best set that time allows."""
        judge = self._judge
        if self._satisfied(start) or judge.late():
            return self._last(start)
        best = start
        if judge.rows_missing:
            best = judge.better(best, judge.as_whole(self._grown()))
            if judge.explained(best):
                return self._last(best)
        for level, most in self._levels(start):
            best = judge.better(best, self._exchanged(level, most))
            if judge.explained(best) or judge.late():
                return self._last(best)
        for from_nothing in (True, False):
            if judge.explained(best) or judge.late():
                break
            start = state_of(judge.model, _NONE, np.zeros(0)) if from_nothing else best
            best = judge.better(best, self._either_sign(start))
        return self._last(best)

    def _last(self, best: State) -> State:
        """Return a set as it is, or where rows are missing the cheapest near it: several explain the frame then."""
        return self._polish.polished(best) if self._judge.rows_missing else best

    def _grown(self) -> State:
        """Return a set of a few units on the coarse model that is built from nothing, a unit after the other.

        Of rows that are filled in, a network may show one touch as half a dozen.
        """
        judge = self._judge
        every, state = np.arange(judge.coarse.n_units), judge.state(_NONE, np.zeros(0), coarse=True)
        while len(state.units) < GROWN and not judge.explained(state):
            free = np.setdiff1d(every, state.units)
            chis = judge.chis(state.with_each(free, judge.usual))
            if chis.min() > GROWS * judge.chi(state):
                break
            units = np.append(state.units, free[int(np.argmin(chis))])
            state = judge.state(units, np.full(len(units), judge.usual), coarse=True)
        return state

    def _satisfied(self, state: State) -> bool:
        """Return whether a set explains the frame, and none of its units is one too many."""
        return self._judge.explained(state) and self._steps.removed(state, self._judge.chi(state)) is None

    def _levels(self, start: State) -> Iterator[tuple[Level, int | None]]:
        """Yield contrasts to search with, and how long at most: those first that explain most on the start's units."""
        judge = self._judge
        coarse = judge.as_coarse(start)
        if not len(coarse.units):
            yield from ((level, None) for level in self._levels_of_nothing(coarse))
            return
        usual = Level(judge.state(coarse.units, np.full(len(coarse.units), judge.usual), coarse=True), "none")
        own = estimated(judge.frame, judge.flat, coarse)
        mean = np.full(len(own), np.exp(np.log(own).mean()))
        common, each = (judge.state(coarse.units, one, coarse=True) for one in (mean, own))
        mixed = bool(own.min() < LOWERED < 1.0 / LOWERED < own.max())
        if judge.chi(usual.start) < NEAR * judge.content:
            yield Level(common, "common"), 0
        if mixed and judge.chi(usual.start) > RATHER * judge.chi(each):
            yield Level(each, "each"), 0
        if judge.chi(usual.start) < SURELY * judge.chi(common):
            yield usual, FIRST
        others = [Level(refitted(judge, common, "common", 1), "common"), Level(each, "each")]
        if mixed:
            others.sort(key=lambda level: judge.chi(level.start) * WORTH[level.free])
        first = judge.chi(usual.start) < UNUSUAL * judge.chi(others[0].start) * WORTH[others[0].free]
        if not first:
            judge.is_hard()
        for level in [usual, *others] if first else [*others, usual]:
            yield level, None

    def _levels_of_nothing(self, nothing: State) -> list[Level]:
        """Return the usual contrast, and another one where one unit of it explains more."""
        judge, every = self._judge, np.arange(self._judge.coarse.n_units)
        found = []
        for contrast in (judge.usual, *OTHERS):
            chi = judge.chis(nothing.with_each(every, contrast))
            unit = np.array([int(np.argmin(chi))])
            found.append((float(chi.min()), judge.state(unit, np.array([contrast]), coarse=True)))
        least = min(found, key=lambda one: one[0])[1]
        levels = [Level(nothing, "none")]
        if least.contrasts[0] != judge.usual:
            levels.insert(0, Level(refitted(judge, least, "common"), "common"))
        return levels

    def _exchanged(self, level: Level, most: int | None = None) -> State:
        """Return a set of a level, units exchanged for others on the coarse model until they explain it."""
        judge, at, free = self._judge, level.start, level.free
        if free == "none":
            return self._of_usual(level.start, most)
        at = refitted(judge, at, free)
        exchange = Exchange(judge, lambda units, own: self._explains(units, own, free), FREE_ALMOST)
        for number in range(ROUNDS):
            candidates, start = candidates_of(at, free, judge.usual)
            starts = [start]
            if not number and free != "each":
                starts += [candidates.bits(units) for units in judge.price.starts]
            self._found = None
            if self._explains(at.units, at.contrasts, free):
                return self._pruned(self._found or at, free)
            if most == 0:
                return judge.as_whole(at)
            bits = exchange.improved(starts, candidates)
            if self._found is not None:
                return self._pruned(self._found, free)
            before = at
            at = judge.state(candidates.units[bits], candidates.contrasts[bits], coarse=True)
            at = refitted(judge, at, free)
            if judge.late() or _same(before, at):
                break
        return judge.as_whole(at)

    def _of_usual(self, start: State, most: int | None) -> State:
        """Return a set of units of the usual contrast; asked again, the search goes on."""
        judge = self._judge
        if self._usual is None:
            exchange = Exchange(judge, lambda units, own: self._explains(units, own, "none"))
            self._usual = exchange, *candidates_of(start, "none", judge.usual)
        exchange, candidates, bits = self._usual
        self._found = None
        starts = [*judge.price.starts, *judge.price.sure]
        bits = exchange.improved([bits, *map(candidates.bits, starts)], candidates, most)
        if self._found is not None:
            return self._pruned(self._found, "none")
        return judge.state(candidates.units[bits], candidates.contrasts[bits])

    def _explains(self, units: Index, contrasts: Array, free: Free) -> bool:
        """Return whether a set that the coarse model found explains the frame; it is then kept."""
        judge = self._judge
        if free == "none":
            state = judge.state(units, contrasts)
        else:
            state = refitted(judge, judge.state(units, contrasts, coarse=True), free)
            if judge.chi(state) > NEARLY * judge.content:
                return False
            state = refitted(judge, judge.as_whole(state), free)
        if not judge.explained(state):
            return False
        self._found = state
        return True

    def _pruned(self, state: State, free: Free) -> State:
        """Return a set that explains the frame without units that it does not need."""
        real = np.abs(np.log(state.contrasts)) > NONE
        if not real.all():
            rest = self._judge.state(state.units[real], state.contrasts[real])
            rest = refitted(self._judge, rest, free)
            state = rest if self._judge.explained(rest) else state
        while not self._judge.late():
            fewer = self._steps.removed(state, self._judge.chi(state))
            if fewer is None:
                return state
            state = refitted(self._judge, fewer, free)
        return state

    def _either_sign(self, state: State) -> State:
        """Return a set after steps with contrasts of either sign, and its contrasts fitted anew."""
        judge, contrasts = self._judge, (self._judge.usual, *OTHERS)
        found = self._steps.descended(state, contrasts)
        if len(found.units) and not judge.late() and not judge.explained(found):
            found = judge.better(found, refitted(judge, found, "each"))
            found = judge.better(found, self._steps.descended(found, contrasts))
        return found


def _key(units: Index, contrasts: Array) -> tuple[tuple[int, ...], tuple[float, ...]]:
    return tuple(units.tolist()), tuple(contrasts.tolist())


def _same(first: State, second: State) -> bool:
    """Return whether two sets are the same, of nearly the same contrasts."""
    one, two = (dict(zip(state.units.tolist(), state.contrasts.tolist(), strict=True)) for state in (first, second))
    return one.keys() == two.keys() and all(abs(np.log(one[unit] / two[unit])) < SAME for unit in one)
