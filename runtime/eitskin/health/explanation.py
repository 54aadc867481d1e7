"""Finds the failure that explains a frame best, by likelihood: one electrode's rows ignored, or two wires exchanged."""

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.health.evidence import LEAST_UNLIKE_WHOLE, Weigher
from eitskin.health.imputation import Array
from eitskin.health.swapped_wires import Rewiring, rewiring
from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS, TABLE

UNKNOWN_ROW: Final = 3.8
"""Cost of a row that is left unexplained: twice the logarithm of the range of l that a faulty row can have."""

SUSPECTS: Final = 6
"""Electrodes of the largest surprise among which an exchange of wires is looked for."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One electrode that is out of order."""

    electrode: int
    state: str
    """``detached``, ``shorted``, ``swapped``, ``noisy``, ``not reciprocal``; ``excluded`` by hand."""
    partner: int | None = None
    """The other electrode of a short or an exchange."""

    @property
    def remedy(self) -> str:
        """``rearranged`` where the rows can be had by sums of others, else ``imputed``."""
        return "rearranged" if self.state == "swapped" else "imputed"

    def text(self) -> str:
        """Return a frame's entry: ``5:detached:imputed``, ``7:swapped with 8:rearranged``."""
        partner = "" if self.partner is None else f" with {self.partner}"
        return f"{self.electrode}:{self.state}{partner}:{self.remedy}"


class Explanation:
    """Compares failures by the residuals that they leave.

    Args:
        weigher: Of the frames.
        precision: (104, 104) P, with this device's noise.
        reference_V: (104,) the reference that dV is taken against.
    """

    def __init__(self, weigher: Weigher, precision: Array, reference_V: Array) -> None:
        self._weigher, self._precision, self._reference = weigher, precision, reference_V
        self._of = weigher.of
        self._pairs = np.array([np.equal(TABLE, pair).any(axis=1) for pair in range(N_ELECTRODES)])

    def shorted_or_detached(self, pair: int, change: npt.NDArray[np.float32]) -> tuple[Finding, ...]:
        """Return a short across a silent pair, or the one of its electrodes whose loss explains more.

        Electrode 0 drives every row of pair 0: detached, it silences that pair as a short does.
        """
        after = (pair + 1) % N_ELECTRODES
        best: tuple[Finding, ...] = (Finding(pair, "shorted", after), Finding(after, "shorted", pair))
        scores, logs = self._score(change)
        cost = self._without(np.flatnonzero(self._pairs[pair]), scores, float(logs @ scores))
        for electrode in (pair, after):
            detached = self._without(self._of[electrode], scores, float(logs @ scores))
            if detached < cost:
                best, cost = (Finding(electrode, "detached"),), detached
        return best

    def _without(self, rows: npt.NDArray[np.intp], scores: Array, total: float) -> float:
        """Return the cost of a frame some rows of which are left unexplained, -2 log likelihood."""
        inner = self._precision[np.ix_(rows, rows)]
        own = float(scores[rows] @ np.linalg.solve(inner, scores[rows]))
        return total - own + float(np.linalg.slogdet(inner)[1]) + UNKNOWN_ROW * len(rows)

    def most_likely(self, change: npt.NDArray[np.float32], surprise: Array, *, swapped: bool) -> tuple[Finding, ...]:
        """Return the one failure that explains a frame best by likelihood, or none.

        Args:
            change: (104,) dV.
            surprise: (16,) of the electrodes.
            swapped: An exchange of wires is known already; there is no second one.
        """
        scores, logs = self._score(change)
        total = float(logs @ scores)
        best: tuple[Finding, ...] = ()
        costs = total
        for electrode in range(N_ELECTRODES):
            cost = self._without(self._of[electrode], scores, total)
            if cost < costs:
                best, costs = (Finding(electrode, "detached"),), cost
        if not swapped:
            volts = (np.asarray(change, dtype=np.float64) + 1.0) * self._reference
            suspects = sorted(np.argsort(surprise)[-SUSPECTS:].tolist())
            for first, second in combinations(suspects, 2):
                cost = self._cost_of_exchange(rewiring(first, second), volts)
                if cost < costs:
                    costs = cost
                    best = (Finding(first, "swapped", second), Finding(second, "swapped", first))
        return best

    def _cost_of_exchange(self, undone: Rewiring, volts: Array) -> float:
        """Return the cost of a frame with two wires exchanged back; infinite if that leaves no sheet's rows."""
        known = self._reference != 0.0  # a row that reads nothing in the reference cannot change
        change = np.divide(undone.matrix @ volts, self._reference, out=np.ones(N_ROWS), where=known) - 1.0
        scores, logs = self._score(change)
        total, missing = float(logs @ scores), np.flatnonzero(undone.missing)
        cost = self._without(missing, scores, total)
        left = cost - self._without(missing, np.zeros(N_ROWS), 0.0)
        return cost if left <= LEAST_UNLIKE_WHOLE * N_ROWS else math.inf

    def _score(self, change: npt.NDArray[np.floating]) -> tuple[Array, Array]:
        """Return (104,) y and l - mean."""
        scores, logs = self._weigher.scores(change[None])
        return scores[0], logs[0]
