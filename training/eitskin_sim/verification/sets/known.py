"""What may be in a set, and which sets are known: the cheapest of them, and those to go on from."""

from dataclasses import dataclass
from heapq import heapify, heappop, heappush

import numpy as np
import numpy.typing as npt

from eitskin_sim.fem.mesh import Array, Index

Bits = npt.NDArray[np.bool_]


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


class Known:
    """Sets that have been judged, the cheapest of them, and those to go on from, each at a stage.

    Args:
        starts: Cost, stage, truth values as bytes, and price of each; at least one.
    """

    def __init__(self, starts: list[tuple[float, int, bytes, float]]) -> None:
        self.open = starts
        heapify(self.open)
        self._seen = {key for _, _, key, _ in starts}
        self.cost, _, key, self._price = self.open[0]
        self.best: Bits = np.frombuffer(key, dtype=np.bool_)

    def is_new(self, bits: Bits) -> bool:
        """Return whether a set has not been judged yet."""
        return bits.tobytes() not in self._seen

    def add(self, cost: float, bits: Bits, price: float) -> None:
        """Keep a set."""
        key = bits.tobytes()
        self._seen.add(key)
        heappush(self.open, (cost, 0, key, price))
        if cost < self.cost:
            self.cost, self.best, self._price = cost, bits, price

    def begin_again(self) -> None:
        """Go on from the best set once more, whatever was tried from it: there are other units to try now."""
        self.open.append((self.cost, 0, self.best.tobytes(), self._price))
        heapify(self.open)

    def later(self, cost: float, stage: int, bits: Bits, price: float) -> None:
        """Go on from a set once more, at another stage."""
        heappush(self.open, (cost, stage, bits.tobytes(), price))

    def cheapest(self) -> tuple[float, int, Bits, float]:
        """Return what is to be gone on from next, and take it away: cost, stage, truth values and price."""
        cost, stage, key, price = heappop(self.open)
        return cost, stage, np.frombuffer(key, dtype=np.bool_), price
