"""The cheapest set that is one step from one that explains the frame: a unit put in, or moved to a place beside.

The first set that explains a frame need not be the cheapest: where rows are missing, several do.
"""

from typing import Final

import numpy as np

from eitskin_sim.reduced.state import State
from eitskin_sim.verification.sets.candidates import Bits, Candidates, Free, candidates_of, own_contrasts
from eitskin_sim.verification.sets.contrasts import refitted
from eitskin_sim.verification.sets.judge import Judge
from eitskin_sim.verification.sets.neighbours import moves_of

MOST: Final = 3
"""Steps of each kind that the whole model judges, of those that look best on the coarse one."""

GAIN: Final = 1.0
"""A step that saves less is none."""


class Polish:
    """Last steps on one frame.

    Args:
        judge: Of sets on the frame.
    """

    def __init__(self, judge: Judge) -> None:
        self._judge = judge

    def polished(self, best: State) -> State:
        """Return the cheapest set near one that explains the frame; any other as it is."""
        judge = self._judge
        free: Free = ("none", "common", "each")[min(own_contrasts(best, judge.usual), 2)]
        while judge.explained(best) and not judge.late():
            candidates, bits = candidates_of(best, free, judge.usual)
            cost, better = judge.cost(best, judge.chi(best)), None
            for child in self._steps(candidates, bits):
                other = refitted(judge, judge.state(candidates.units[child], candidates.contrasts[child]), free)
                if judge.cost(other, judge.chi(other)) < cost - GAIN:
                    better = other
                    break
            if better is None:
                return best
            best = better
        return best

    def _steps(self, of: Candidates, bits: Bits) -> list[Bits]:
        """Return the sets one step away that look cheaper than a set, the cheapest first."""
        judge = self._judge
        state = judge.state(of.units[bits], of.contrasts[bits], coarse=True)
        touched = np.zeros(judge.model.n_units, dtype=np.bool_)
        touched[state.units] = True
        prices, chi = judge.price.flips(touched), judge.chi(state)
        steps = moves_of(judge, of, bits, prices, 1.0, MOST)
        free = np.flatnonzero(~touched[of.units])
        for contrast in np.unique(of.contrasts[free]):
            at = free[of.contrasts[free] == contrast]
            chis, own = judge.chis(state.with_each(of.units[at], float(contrast))), prices[of.units[at]]
            steps += [(float(chis[one]), float(own[one]), at[[one]]) for one in np.argsort(chis + own)[:MOST]]
        found = []
        for after, own, flipped in sorted(steps, key=lambda step: step[0] + step[1]):
            if after + own < chi - GAIN:
                child = bits.copy()
                child[flipped] ^= True
                found.append(child)
        return found
