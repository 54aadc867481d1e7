"""Which electrodes have failed, from the frames alone, within a few dozen milliseconds.

Each electrode has 26 of the 104 rows, and the others say what those should be (:mod:`eitskin.imputation`). An
electrode's *surprise* compares how far its rows are from that with how far everything else is from the ordinary, so
that a heavy touch, which is far from ordinary everywhere, surprises nowhere in particular::

    D_e = y_e^T P_ee^-1 y_e          surprise_e = (D_e / 26) / ((2 + D - D_e) / (2 + 78))      D = (l - mean)^T y

Three kinds of failure do something that no touch does, and are known by it: a shorted pair of neighbours reads
nothing at all, exchanged neighbours read the reverse, a loose contact jumps from frame to frame in all its rows and in
no others. All evidence is counted: ``NEEDED`` of the last ``WINDOW`` frames must agree. What then explains the frame
best, one electrode's rows unexplained or two wires exchanged, by likelihood, is what is reported.

An electrode is taken back after ``HEALTHY`` frames in a row without any of this. Nothing here is in a frame's way: a
frame is looked at after it was published.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.imputation import Array, Consistency, Imputation, rows_of
from eitskin.rewiring import Rewiring, rewiring
from eitskin_proto.table import N_ELECTRODES, N_ROWS, TABLE

WINDOW: Final = 14
"""Frames over which evidence is counted."""

NEEDED: Final = 10
"""Frames of them that must agree: a failure is named 10 to 14 frames after it began."""

HEALTHY: Final = 200
"""Frames in a row without evidence after which an electrode is used again: one second at 200 frames/s."""

MOST_OUT: Final = 4
"""Electrodes that may be out at a time; with fewer than twelve left nothing is filled in that deserves the name."""

FREEDOM: Final = 2.0
"""Of the t distribution whose conditional gives the surprise: touches are far more varied than a Gaussian allows."""

SHORTED_RATIO: Final = 0.01
"""A pair that reads less than this of its reference is shorted: the heaviest touches leave 0.02."""

OPEN_RATIO: Final = 0.05
"""Its neighbours read more than this: a detached electrode silences both of its pairs."""

REVERSED_RATIO: Final = -0.2
"""A pair whose rows, weighted by their size, read less than this is reversed; a sheet never reads below 0."""

JUMP: Final = 4.0
"""Standard deviations of a row's second difference that count as a jump."""

JUMPING_ROWS: Final = 6
"""Rows of a pair's 13 that must jump at once: a loose contact's pair, in half of its draws or more."""

USUAL_NOISE: Final = 0.005
"""Relative noise of a row that the samples had; where a reference's frames vary by more, so may these."""

UNKNOWN_ROW: Final = 3.8
"""Cost of a row that is left unexplained: twice the logarithm of the range of l that a faulty row can have."""

SUSPECTS: Final = 6
"""Electrodes of the largest surprise among which an exchange of wires is looked for."""

WELL: Final = "well"


@dataclass(frozen=True, slots=True)
class Finding:
    """One electrode that is out of order."""

    electrode: int
    state: str
    """``detached``, ``shorted``, ``swapped``, ``noisy``; ``excluded`` by hand."""
    partner: int | None = None
    """The other electrode of a short or an exchange."""

    @property
    def remedy(self) -> str:
        """``rearranged`` where the rows can be had by sums of others, else ``imputed``."""
        return "rearranged" if self.state == "swapped" else "imputed"

    def text(self) -> str:
        """Return what a frame says: ``5:detached:imputed``, ``7:swapped with 8:rearranged``."""
        partner = "" if self.partner is None else f" with {self.partner}"
        return f"{self.electrode}:{self.state}{partner}:{self.remedy}"


@dataclass(slots=True, eq=False)
class Evidence:
    """What the last frame said of each electrode, for whoever wants to see it."""

    surprise: Array
    """(16,) against the threshold of ``ElectrodeWatch.threshold``."""
    pair_ratio: Array
    """(16,) |V| of pair e, e + 1 against its reference."""
    pair_sign: Array
    """(16,) the same with sign."""
    jumping: Array
    """(16,) share of the pair's rows that jumped."""
    total: float
    """Of the whole frame, per row."""


class ElectrodeWatch:
    """Looks at one frame after another.

    Args:
        consistency: Of the bundle.
        reference_V: (104,) the reference that dV is taken against.
        spread_V: (104,) standard deviation of its single frames.
        excluded: Electrodes left out by hand, for good.
    """

    def __init__(
        self, consistency: Consistency, reference_V: Array, spread_V: Array, excluded: tuple[int, ...] = ()
    ) -> None:
        sigma = np.maximum(spread_V / np.maximum(np.abs(reference_V), 1e-30), 5e-4)
        usable = np.isfinite(sigma) & (sigma < 1.0)
        self._sigma = np.where(usable, sigma, 1.0)
        self.precision = consistency.precision(np.maximum(self._sigma**2 - USUAL_NOISE**2, 0.0))
        """(104, 104) P with this device's noise."""
        self.threshold, self.threshold_total = (float(value) for value in consistency.thresholds)
        self._mean = consistency.mean
        self._range = consistency.ratio_range
        self._reference = reference_V
        self._of = np.array([np.flatnonzero(rows_of((electrode,))) for electrode in range(N_ELECTRODES)])
        self._inner = np.array([np.linalg.inv(self.precision[np.ix_(rows, rows)]) for rows in self._of])
        self._pairs = np.array([np.equal(TABLE, pair).any(axis=1) for pair in range(N_ELECTRODES)], dtype=np.float64)
        weight = self._pairs * np.abs(reference_V)
        self._pair_weight = weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-30)
        self._logs, self._scores = np.zeros(N_ROWS), np.zeros(N_ROWS)
        self._history = np.zeros((WINDOW, 3 * N_ELECTRODES + 1), dtype=np.bool_)
        self._before = np.zeros((2, N_ROWS))
        self._seen = 0
        self._resting = 0
        self._pair_in_use = np.ones(N_ELECTRODES, dtype=np.bool_)
        self._healthy: dict[int, int] = {}
        self.imputation = Imputation(self._mean, self.precision, self._range)
        """Fills in what is missing."""
        self.rearranged: Rewiring | None = None
        """Undoes an exchange of wires."""
        self.findings: tuple[Finding, ...] = ()
        self.texts: tuple[str, ...] = ()
        """What a frame says of electrodes that are not well."""
        self.unclear = False
        """The frames fit nothing: neither a sheet nor any single failure."""
        nothing = np.zeros(N_ELECTRODES)
        self.evidence = Evidence(nothing, nothing, nothing, nothing, 0.0)
        self.exclude(excluded)

    @property
    def missing(self) -> npt.NDArray[np.bool_]:
        """(104,) rows that are filled in."""
        return self.imputation.missing

    def states(self) -> tuple[str, ...]:
        """Return the state of all 16."""
        named = {finding.electrode: finding.state for finding in self.findings}
        return tuple(named.get(electrode, WELL) for electrode in range(N_ELECTRODES))

    def exclude(self, electrodes: tuple[int, ...]) -> None:
        """Leave these electrodes out by hand, and no others by hand any more.

        Raises:
            ValueError: One does not exist, or there are too many.
        """
        self.check(electrodes)
        chosen = tuple(sorted(set(electrodes)))
        kept = tuple(f for f in self.findings if f.state != "excluded" and f.electrode not in chosen)
        self._use((*kept, *(Finding(electrode, "excluded") for electrode in chosen)))

    @staticmethod
    def check(electrodes: tuple[int, ...]) -> None:
        """Refuse electrodes that cannot be excluded.

        Raises:
            ValueError: One does not exist, or there are too many.
        """
        if len(set(electrodes)) > MOST_OUT or any(not 0 <= electrode < N_ELECTRODES for electrode in electrodes):
            raise ValueError(f"electrodes {electrodes} to exclude; expected at most {MOST_OUT}, from 0 to 15")

    def correct(self, change: npt.NDArray[np.float32]) -> None:
        """Rearrange and fill in (104,) dV, in place, for the failures that are known."""
        if self.rearranged is not None:
            volts = (change.astype(np.float64) + 1.0) * self._reference
            change[:] = self.rearranged.matrix @ volts / self._reference - 1.0
        self.imputation.fill(change)

    def look(self, raw: npt.NDArray[np.float32], change: npt.NDArray[np.float32]) -> bool:
        """Take one frame's evidence and return whether any electrode's state changed.

        Args:
            raw: (104,) dV as measured.
            change: (104,) the same after :meth:`correct`.
        """
        now = self._take(raw, change)
        self._history[self._seen % WINDOW] = now
        self._seen += 1
        changed = False
        if self.findings:
            changed = self._take_back(raw, change)
        if self._resting:
            self._resting -= 1
            return changed
        counts = self._history.sum(axis=0)
        if counts.max() < NEEDED:
            self.unclear = self.unclear and bool(counts[-1])
            return changed
        return self._judge(counts, change) or changed

    def _take(self, raw: npt.NDArray[np.float32], change: npt.NDArray[np.float32]) -> npt.NDArray[np.bool_]:
        """Return (49,) what this frame says: surprising, shorted or reversed, jumping, and the whole."""
        evidence = self.evidence
        evidence.surprise, evidence.total = self.surprise(change)
        ratio = raw.astype(np.float64) + 1.0
        evidence.pair_sign = self._pair_weight @ ratio
        evidence.pair_ratio = self._pair_weight @ np.abs(ratio)
        jump = np.abs(raw - 2.0 * self._before[0] + self._before[1])
        self._before[1], self._before[0] = self._before[0], raw
        jumping = jump > JUMP * np.sqrt(6.0) * self._sigma * np.maximum(np.abs(ratio), 1.0)
        of_pair = self._pairs @ jumping
        evidence.jumping = of_pair / self._pairs.sum(axis=1)
        now = np.zeros(3 * N_ELECTRODES + 1, dtype=np.bool_)
        worst = int(np.argmax(evidence.surprise))
        now[worst] = evidence.surprise[worst] > self.threshold
        beside = np.minimum(np.roll(evidence.pair_ratio, 1), np.roll(evidence.pair_ratio, -1))
        shorted = (evidence.pair_ratio < SHORTED_RATIO) & (beside > OPEN_RATIO)
        now[16:32] = (shorted | (evidence.pair_sign < REVERSED_RATIO)) & self._pair_in_use
        both = np.minimum(of_pair, np.roll(of_pair, 1)) >= JUMPING_ROWS  # pairs e - 1 and e
        alone = np.array([jumping.sum() - jumping[rows].sum() for rows in self._of]) <= 0.2 * (N_ROWS - 26)
        now[32:48] = both & alone & (self._seen > 1)
        now[48] = evidence.total > self.threshold_total
        return now

    def surprise(self, change: npt.NDArray[np.float32]) -> tuple[Array, float]:
        """Return the (16,) surprises of (104,) dV, and that of the whole frame per row."""
        scores, logs = self._score(change)
        part = scores[self._of]
        own = np.matmul(np.matmul(part[:, None, :], self._inner), part[:, :, None])[:, 0, 0]
        total = float(logs @ scores)
        rest = np.maximum(total - own, 0.0)
        return np.asarray((own / 26.0) / ((FREEDOM + rest) / (FREEDOM + N_ROWS - 26.0))), total / N_ROWS

    def _score(self, change: npt.NDArray[np.floating]) -> tuple[Array, Array]:
        """Return (104,) y and l - mean."""
        np.clip(change, self._range[0] - 1.0, self._range[1] - 1.0, out=self._logs)
        np.log1p(self._logs, out=self._logs)
        np.subtract(self._logs, self._mean, out=self._logs)
        np.matmul(self.precision, self._logs, out=self._scores)
        return self._scores, self._logs

    def _judge(self, counts: npt.NDArray[np.intp], change: npt.NDArray[np.float32]) -> bool:
        """Say what explains the frame best, and act on it."""
        out = {finding.electrode for finding in self.findings}
        jumping = [int(e) for e in np.flatnonzero(counts[32:48] >= NEEDED // 2) if int(e) not in out]
        shorted = self.evidence.pair_ratio < SHORTED_RATIO
        pair = int(np.argmax(counts[16:32]))
        found: tuple[Finding, ...] = ()
        if counts[16 + pair] >= NEEDED and shorted[pair]:
            found = self._shorted_or_detached(pair, change)
        elif jumping:
            found = (Finding(max(jumping, key=lambda e: counts[32 + e]), "noisy"),)
        else:
            found = self._most_likely(change)
        found = tuple(finding for finding in found if finding.electrode not in out)
        self._history[:] = False
        if not found or len(out) + len(found) > MOST_OUT:
            self.unclear = True
            self._resting = WINDOW
            return False
        self.unclear = False
        self._use((*self.findings, *found))
        return True

    def _shorted_or_detached(self, pair: int, change: npt.NDArray[np.float32]) -> tuple[Finding, ...]:
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
        inner = self.precision[np.ix_(rows, rows)]
        own = float(scores[rows] @ np.linalg.solve(inner, scores[rows]))
        return total - own + float(np.linalg.slogdet(inner)[1]) + UNKNOWN_ROW * len(rows)

    def _most_likely(self, change: npt.NDArray[np.float32]) -> tuple[Finding, ...]:
        """Return the one failure that explains a frame best by likelihood, or none."""
        scores, logs = self._score(change)
        scores, total = scores.copy(), float(logs @ scores)
        best: tuple[Finding, ...] = ()
        costs = total
        for electrode in range(N_ELECTRODES):
            cost = self._without(self._of[electrode], scores, total)
            if cost < costs:
                best, costs = (Finding(electrode, "detached"),), cost
        if self.rearranged is None:
            volts = (np.asarray(change, dtype=np.float64) + 1.0) * self._reference
            suspects = sorted(np.argsort(self.evidence.surprise)[-SUSPECTS:].tolist())
            for first, second in combinations(suspects, 2):
                cost = self._cost_of_exchange(rewiring(first, second), volts)
                if cost < costs:
                    costs = cost
                    best = (Finding(first, "swapped", second), Finding(second, "swapped", first))
        return best

    def _cost_of_exchange(self, undone: Rewiring, volts: Array) -> float:
        change = undone.matrix @ volts / self._reference - 1.0
        scores, logs = self._score(change)
        return self._without(np.flatnonzero(undone.missing), scores, float(logs @ scores))

    def _take_back(self, raw: npt.NDArray[np.float32], change: npt.NDArray[np.float32]) -> bool:
        """Count healthy frames of electrodes that are out, and use them again after ``HEALTHY`` of them."""
        back = []
        for finding in self.findings:
            if finding.state == "excluded":
                continue
            electrode = finding.electrode
            healthy = self._is_healthy(finding, raw, change)
            self._healthy[electrode] = self._healthy.get(electrode, 0) + 1 if healthy else 0
            if self._healthy[electrode] >= HEALTHY:
                back.append(electrode)
        if not back:
            return False
        self._use(tuple(f for f in self.findings if f.electrode not in back and f.partner not in back))
        return True

    def _is_healthy(self, finding: Finding, raw: npt.NDArray[np.float32], change: npt.NDArray[np.float32]) -> bool:
        electrode, evidence = finding.electrode, self.evidence
        if finding.state == "swapped":
            return self.surprise(raw)[1] < self.threshold_total and float(evidence.pair_sign.min()) > 0.0
        pairs = [electrode, (electrode - 1) % N_ELECTRODES]
        if evidence.pair_ratio[pairs].min() < SHORTED_RATIO or evidence.pair_sign[pairs].min() < 0.0:
            return False
        if finding.state == "noisy" and evidence.jumping[pairs].min() > 0.1:
            return False
        others = tuple(f.electrode for f in self.findings if f.electrode not in (electrode, finding.partner))
        mine = rows_of((electrode,)) & ~rows_of(others)
        surprise, _ = self.surprise(np.where(mine, raw, change))
        return bool(surprise[electrode] < self.threshold / 3.0)

    def _use(self, findings: tuple[Finding, ...]) -> None:
        """Go on with these failures from the next frame on."""
        self.findings = tuple(sorted(findings, key=lambda finding: finding.electrode))
        self.texts = tuple(finding.text() for finding in self.findings)
        self._healthy = {}
        self._history[:] = False
        out = tuple(f.electrode for f in self.findings if f.remedy == "imputed")
        rows = rows_of(out)
        swapped = next((f for f in self.findings if f.state == "swapped" and f.partner is not None), None)
        self.rearranged = None
        if swapped is not None and swapped.partner is not None:
            self.rearranged = rewiring(swapped.electrode, swapped.partner)
            rows = rows | self.rearranged.missing
        taken = np.isin(np.arange(N_ELECTRODES), [finding.electrode for finding in self.findings])
        self._pair_in_use = ~(taken | np.roll(taken, -1))
        self.imputation.leave_out(rows, self.precision)
