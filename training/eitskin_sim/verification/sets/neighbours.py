"""Units of a set moved to a place beside, and two of them merged into the one between: the errors of a good guess.

No pool is asked: every unit beside one of the set is looked at.
"""

from typing import Final

import numpy as np

from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.verification.sets.candidates import Bits, Candidates
from eitskin_sim.verification.sets.judge import Judge

BETWEEN: Final = 2
"""Units that are merged into one lie so far from each other."""


def moves_of(
    judge: Judge, of: Candidates, bits: Bits, prices: Array, inflation: float, most: int
) -> list[tuple[float, float, Index]]:
    """Return chi-squared, price beside the set's own and flipped candidates of the best moves.

    Args:
        judge: Of sets on the frame.
        of: What may be in a set.
        bits: (candidates,) the set.
        prices: (units,) what flipping each adds to the set's price.
        inflation: By which gains in chi-squared are divided.
        most: Moves that are returned.
    """
    inside = np.flatnonzero(bits)
    gone, which, into = _moves(of, inside, judge.distance)
    if not len(which):
        return []
    units = of.units[inside]
    own = np.where(gone < 0, 0.0, prices[units[gone]]).sum(axis=1)[which] + prices[of.units[into]]
    chis = _judged(judge, of, inside, gone[which], into)
    best = np.argsort(chis / inflation + own)[:most]
    return [
        (float(chis[at]), float(own[at]), np.append(inside[out[out >= 0]], into[at]))
        for at, out in zip(best.tolist(), gone[which[best]], strict=True)
    ]


def _moves(of: Candidates, inside: Index, distance: Index) -> tuple[Index, Index, Index]:
    """Return (g, 2) places in the set of one or two units that go, -1 for none, (m,) which of these, and who comes.

    Who comes in is a candidate whose unit lies beside all of them.
    """
    units = of.units[inside]
    touched = np.zeros(len(distance), dtype=np.bool_)
    touched[units] = True
    near = (distance[units] == 1) & ~touched
    first, second = np.nonzero(np.triu(distance[np.ix_(units, units)] == BETWEEN, 1))
    one = np.stack([np.arange(len(units)), np.full(len(units), -1)], axis=1)
    which, into = np.nonzero(np.concatenate([near, near[first] & near[second]])[:, of.units])
    return np.concatenate([one, np.stack([first, second], axis=1)]), which, into


def _judged(judge: Judge, of: Candidates, inside: Index, gone: Index, into: Index) -> Array:
    """Return (m,) the chi-squared of moves."""
    state = judge.state(of.units[inside], of.contrasts[inside], coarse=True)
    found, contrasts, two = np.empty(len(into)), of.contrasts[into], gone[:, 1] >= 0
    for contrast in np.unique(contrasts):
        at = contrasts == contrast
        came, number = np.unique(into[at], return_inverse=True)
        beside = state.beside(of.units[came], float(contrast))
        for many, own in ((1, ~two[at]), (2, two[at])):
            if own.any():
                found[np.flatnonzero(at)[own]] = judge.chis(beside.instead(gone[at][own, :many], number[own]))
    return found
