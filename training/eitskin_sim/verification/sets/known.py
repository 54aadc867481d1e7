"""Which sets are known: the cheapest of them, and those to go on from."""

from heapq import heapify, heappop, heappush

import numpy as np

from eitskin_sim.verification.sets.candidates import Bits


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
