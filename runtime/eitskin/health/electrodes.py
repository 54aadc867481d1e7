"""Detects failed electrodes from the frames alone, within a few dozen milliseconds.

Each electrode has 26 of the 104 rows, and the other rows predict them (:mod:`eitskin.health.imputation`). Each frame
votes on each electrode (:mod:`eitskin.health.evidence`): surprise, silence, reversal, jumps. ``AGREEING_FRAMES`` of the
last ``WINDOW`` frames must agree. The failure that then explains the frame best is reported
(:mod:`eitskin.health.explanation`).

An electrode counts as healthy again after ``HEALTHY`` frames in a row without any of this. None of this delays a frame:
frames are examined after they were published, several at a time.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.health.evidence import JUMPING, N_VOTES, PAIR_WRONG, SHORTED_RATIO, WHOLE, Evidence, Votes, Weigher
from eitskin.health.explanation import Explanation, Finding
from eitskin.health.imputation import UNPREDICTED, Array, Consistency, Imputation, Rows
from eitskin.health.swapped_wires import Rewiring, rewiring
from eitskin.reference.row_noise import lost_rows, relative_spread, weighed_rows
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ELECTRODES

WINDOW: Final = 14
"""Frames over which evidence is counted."""

AGREEING_FRAMES: Final = 10
"""Frames of them that must agree: a failure is named 10 to 14 frames after it began."""

HEALTHY: Final = 200
"""Frames in a row without evidence after which an electrode is used again: one second at 200 frames/s."""

MAX_OUT: Final = 4
"""Electrodes that may be out at a time; with fewer than twelve left nothing is filled in that deserves the name."""

USUAL_NOISE: Final = 0.005
"""Relative noise of a row that the samples had; where a reference's frames vary by more, so may these."""

WELL: Final = "well"

FITTED: Final = ("detached", "shorted", "swapped")
"""States of electrodes whose rows do not fit the others'."""

NOT_RECIPROCAL: Final = "not reciprocal"
"""State of an electrode that :mod:`eitskin.health.reciprocity` found; it goes back into use by the same evidence."""


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
        self.sigma = relative_spread(reference_V, spread_V)
        """(104,) relative standard deviation of the reference's single frames."""
        extra = np.maximum(self.sigma**2 - USUAL_NOISE**2, 0.0)
        self.precision = consistency.precision(extra)
        """(104, 104) P with this device's noise."""
        self._weak = self._lost = lost_rows(reference_V, spread_V)
        self._noise = np.where(weighed_rows(reference_V, spread_V), extra, 0.0)
        self._noisy = self._noise > 0.0
        self.threshold, self.threshold_total = (float(value) for value in consistency.thresholds)
        self._mean = consistency.mean
        self._range = consistency.ratio_range
        self._reference = reference_V
        thresholds = np.array([self.threshold, self.threshold_total])
        self.weigher = Weigher(
            consistency.mean, self.precision, consistency.ratio_range, reference_V, self.sigma, thresholds
        )
        """Gives each frame's evidence."""
        self._explanation = Explanation(self.weigher, self.precision, reference_V)
        self._history: Votes = np.zeros((WINDOW, N_VOTES), dtype=np.bool_)
        self._suspected = False
        """Whether any vote is in the history."""
        self._seen = 0
        self._pause = 0
        self._pair_in_use = np.ones(N_ELECTRODES, dtype=np.bool_)
        self._healthy: dict[int, int] = {}
        self.imputation = Imputation(self._mean, self.precision, self._range, consistency.layers)
        """Fills in missing rows."""
        self.rearranged: Rewiring | None = None
        """Undoes an exchange of wires."""
        self.findings: tuple[Finding, ...] = ()
        self.texts: tuple[str, ...] = ()
        """A frame's entries for failed electrodes."""
        self.unclear = False
        """The frames fit nothing: neither a sheet nor any single failure."""
        self.alters = False
        """Whether :meth:`correct` changes anything."""
        self.lacks_rows = False
        """Whether rows are filled in altogether."""
        self._row = -1
        self.exclude(excluded)

    @property
    def evidence(self) -> Evidence:
        """The votes of the last frame."""
        return self.weigher.evidence(self._row)

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
        self.set_findings((*kept, *(Finding(electrode, "excluded") for electrode in chosen)))

    @staticmethod
    def check(electrodes: tuple[int, ...]) -> None:
        """Refuse electrodes that cannot be excluded.

        Raises:
            ValueError: One does not exist, or there are too many.
        """
        if len(set(electrodes)) > MAX_OUT or any(not 0 <= electrode < N_ELECTRODES for electrode in electrodes):
            raise ValueError(f"electrodes {electrodes} to exclude; expected at most {MAX_OUT}, from 0 to 15")

    def leave_out(self, rows: Rows, findings: tuple[Finding, ...] | None = None) -> None:
        """Fill in some rows, beside those of electrodes and those that are lost in noise.

        Args:
            rows: (104,)
            findings: The failures to go on with; None for the present ones.
        """
        self._lost = self._weak | rows
        self.set_findings(self.findings if findings is None else findings)

    def is_doubtful(self, raw: npt.NDArray[np.float32], change: npt.NDArray[np.float32]) -> bool:
        """Return whether a frame reads well at every electrode that was named by its rows, as if nothing failed.

        Args:
            raw: (104,) dV as measured.
            change: The same after :meth:`correct`.
        """
        named = [finding for finding in self.findings if finding.state in FITTED]
        return bool(named) and all(self._fits(finding, raw, change) for finding in named)

    def give_up(self, electrode: int) -> bool:
        """Leave an electrode out because it is not reciprocal, and return whether it is, now, for that reason.

        Findings from 104 rows come first, and no more than ``MAX_OUT`` electrodes are excluded.
        """
        if len(self.findings) >= MAX_OUT or any(finding.electrode == electrode for finding in self.findings):
            return False
        self.set_findings((*self.findings, Finding(electrode, NOT_RECIPROCAL)))
        return True

    def trust(self, electrode: int) -> None:
        """Use an electrode again that was not reciprocal."""
        self.set_findings(tuple(f for f in self.findings if f.electrode != electrode or f.state != NOT_RECIPROCAL))

    def correct(self, change: npt.NDArray[np.float32], predicted: npt.NDArray[np.float32] = UNPREDICTED) -> None:
        """Rearrange and fill in (104,) dV, in place, for the failures that are known.

        Args:
            change: (104,) dV.
            predicted: (104,) log(V_pred / V0) of the cloud in use; zeros without one.
        """
        self.rearrange(change)
        self.imputation.fill(change, predicted)

    def rearrange(self, change: npt.NDArray[np.float32]) -> None:
        """Undo an exchange of wires in (104,) dV, in place, if there is one."""
        if self.rearranged is not None:
            volts = (change.astype(np.float64) + 1.0) * self._reference
            change[:] = self.rearranged.matrix @ volts / self._reference - 1.0

    def update(self, raw: npt.NDArray[np.float32], change: npt.NDArray[np.float32]) -> bool:
        """Take the evidence of one frame or of several in a row and return whether any electrode's state changed.

        Frames after a change are ignored, because they were corrected with the earlier findings.

        Args:
            raw: (104,) or (n, 104) dV as measured.
            change: The same after :meth:`correct`.
        """
        raw, change = np.atleast_2d(raw), np.atleast_2d(change)
        if self._noisy.any() and self.rearranged is None:
            measured = self._noisy & ~self.missing
            change = np.where(measured, raw, change)  # P knows of their noise: evidence is what was measured
        votes = self.weigher.weigh(raw, change, self._pair_in_use)
        suspicious = bool(votes.any())
        if not (suspicious or self._suspected or self.findings or self._pause or self.unclear):
            self._row = -1
            self._seen += len(raw)  # nothing to write down: the history holds no vote
            return False
        for row, vote in enumerate(votes):
            self._row = row
            if self._count(vote, raw[row], change[row]):
                return True
        return False

    def _count(self, vote: Votes, raw: npt.NDArray[np.float32], change: npt.NDArray[np.float32]) -> bool:
        """Take one frame's votes and return whether any electrode's state changed."""
        self._history[self._seen % WINDOW] = vote
        self._seen += 1
        changed = False
        if self.findings:
            changed = self._take_back(raw, change)
        if self._pause:
            self._pause -= 1
            return changed
        counts = self._history.sum(axis=0)
        self._suspected = bool(counts.any())
        if counts.max() < AGREEING_FRAMES:
            self.unclear = self.unclear and bool(counts[WHOLE])
            return changed
        return self._judge(counts, change) or changed

    def surprise(self, change: npt.NDArray[np.floating]) -> tuple[Array, float]:
        """Return the (16,) surprises of (104,) dV, and that of the whole frame per row."""
        surprise, total = self.weigher.surprise(change[None])
        return surprise[0], float(total[0])

    def _judge(self, counts: npt.NDArray[np.intp], change: npt.NDArray[np.float32]) -> bool:
        """Report the failure that explains the frame best, and act on it."""
        out = {finding.electrode for finding in self.findings}
        jumping = [int(e) for e in np.flatnonzero(counts[JUMPING] >= AGREEING_FRAMES // 2) if int(e) not in out]
        shorted = self.evidence.pair_ratio < SHORTED_RATIO
        pair = int(np.argmax(counts[PAIR_WRONG]))
        found: tuple[Finding, ...] = ()
        if counts[PAIR_WRONG][pair] >= AGREEING_FRAMES and shorted[pair]:
            found = self._explanation.shorted_or_detached(pair, change)
        elif jumping:
            found = (Finding(max(jumping, key=lambda e: counts[JUMPING][e]), "noisy"),)
        else:
            found = self._explanation.most_likely(change, self.evidence.surprise, swapped=self.rearranged is not None)
        found = tuple(finding for finding in found if finding.electrode not in out)
        self._history[:] = False
        if not found or len(out) + len(found) > MAX_OUT:
            self.unclear = True
            self._pause = WINDOW
            return False
        self.unclear = False
        self.set_findings((*self.findings, *found))
        return True

    def _take_back(self, raw: npt.NDArray[np.float32], change: npt.NDArray[np.float32]) -> bool:
        """Count healthy frames of electrodes that are out, and use them again after ``HEALTHY`` of them."""
        back = []
        for finding in self.findings:
            if finding.state in ("excluded", NOT_RECIPROCAL):
                continue
            electrode = finding.electrode
            healthy = self._is_healthy(finding, raw, change)
            self._healthy[electrode] = self._healthy.get(electrode, 0) + 1 if healthy else 0
            if self._healthy[electrode] >= HEALTHY:
                back.append(electrode)
        if not back:
            return False
        self.set_findings(tuple(f for f in self.findings if f.electrode not in back and f.partner not in back))
        return True

    def _is_healthy(self, finding: Finding, raw: npt.NDArray[np.float32], change: npt.NDArray[np.float32]) -> bool:
        electrode, evidence = finding.electrode, self.evidence
        if finding.state == "swapped":
            return self._fits(finding, raw, change) and float(evidence.pair_sign.min()) > 0.0
        pairs = [electrode, (electrode - 1) % N_ELECTRODES]
        if evidence.pair_ratio[pairs].min() < SHORTED_RATIO or evidence.pair_sign[pairs].min() < 0.0:
            return False
        if finding.state == "noisy" and evidence.jumping[pairs].min() > 0.1:
            return False
        return self._fits(finding, raw, change)

    def _fits(self, finding: Finding, raw: npt.NDArray[np.float32], change: npt.NDArray[np.float32]) -> bool:
        """Return whether what was measured at an electrode fits the other rows."""
        electrode = finding.electrode
        if finding.state == "swapped":
            return self.surprise(raw)[1] < self.threshold_total
        others = tuple(f.electrode for f in self.findings if f.electrode not in (electrode, finding.partner))
        mine = rows_of((electrode,)) & ~rows_of(others)
        surprise, _ = self.surprise(np.where(mine, raw, change))
        return bool(surprise[electrode] < self.threshold / 3.0)

    def set_findings(self, findings: tuple[Finding, ...]) -> None:
        """Go on with these failures from the next frame on."""
        self.findings = tuple(sorted(findings, key=lambda finding: finding.electrode))
        self.texts = tuple(finding.text() for finding in self.findings)
        self._healthy = {}
        self._history[:] = False
        out = tuple(f.electrode for f in self.findings if f.remedy == "imputed")
        rows = rows_of(out) | self._lost
        swapped = next((f for f in self.findings if f.state == "swapped" and f.partner is not None), None)
        self.rearranged = None
        if swapped is not None and swapped.partner is not None:
            self.rearranged = rewiring(swapped.electrode, swapped.partner)
            rows = rows | self.rearranged.missing
        taken = np.isin(np.arange(N_ELECTRODES), [finding.electrode for finding in self.findings])
        self._pair_in_use = ~(taken | np.roll(taken, -1))
        self.imputation.leave_out(rows, self.precision, out, self._noise)
        self.weigher.forget_step()
        self.lacks_rows = bool(rows.any())
        self.alters = self.rearranged is not None or not self.imputation.idle
