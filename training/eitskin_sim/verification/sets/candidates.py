"""What may be in a set, and which contrasts of it are fitted."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.reduced.state import State
from eitskin_sim.verification.sets.price import OTHERS

Bits = npt.NDArray[np.bool_]

Free = Literal["none", "common", "each"]
"""Which contrasts are fitted: none, one for all units, or one for each."""


@dataclass(frozen=True, slots=True)
class Candidates:
    """What may be in a set: units, each at one contrast or at several, of which a set holds at most one."""

    units: Index
    """(m,)"""
    contrasts: Array
    """(m,) none 1."""

    @classmethod
    def of(cls, *contrasts: Array) -> "Candidates":
        """Return all units at each of some contrasts, (units,) each."""
        every = np.arange(len(contrasts[0]))
        return cls(np.tile(every, len(contrasts)), np.concatenate(contrasts))

    def bits(self, units: Index) -> Bits:
        """Return (m,) which candidates a set of units is, each at its first contrast."""
        found = np.zeros(len(self.units), dtype=np.bool_)
        found[units] = True
        return found


def own_contrasts(state: State, usual: float) -> int:
    """Return how many contrasts a set has that are not the usual one."""
    return len(np.unique(state.contrasts[state.contrasts != usual]))


def candidates_of(at: State, free: Free, usual: float) -> tuple[Candidates, Bits]:
    """Return what may be in a set of some contrasts, and which of it a set is.

    Args:
        at: The set.
        free: Whether all units have the usual contrast, the set's first one, or each its own, of either sign.
        usual: The usual contrast.
    """
    n = at.model.n_units
    if free != "each":
        level = at.contrasts[0] if free == "common" and len(at.units) else usual
        candidates = Candidates.of(np.full(n, level))
        return candidates, candidates.bits(at.units)
    levels = []
    for sign, otherwise in zip((1.0, -1.0), (10.0, OTHERS[0]), strict=True):
        mine = np.sign(np.log(at.contrasts)) == sign
        own = at.contrasts[mine]
        levels.append(np.full(n, np.exp(np.log(own).mean()) if len(own) else otherwise))
        levels[-1][at.units[mine]] = own
    candidates = Candidates.of(*levels)
    return candidates, candidates.bits(np.where(at.contrasts > 1.0, at.units, at.units + n))
