"""Evidence from frames for each electrode's failure: numbers, and a vote of each frame for each suspicion.

An electrode's *surprise* divides the distance of its rows from their prediction by the other rows' distance from the
mean. So a heavy touch, which moves all rows, surprises at no particular electrode::

    D_e = y_e^T P_ee^-1 y_e          surprise_e = (D_e / 26) / ((2 + D - D_e) / (2 + 78))      D = (l - mean)^T y

Any two rows surprise the same way, by which rows are found that were exchanged (``LEAST_UNLIKE``). Two drives or two
measurements were exchanged if D is much less after they are exchanged back (``EXCHANGED_RATIO``).

No touch or bend only exchanges readings, moves few rows alone, or multiplies the rows of one drive or one measurement
by a factor. With x the change of a frame's l against the reference, or against the last frame that was fit ::

    rms(sort(l + log V0) - sort(log V0)) < SORTED_SHARE rms(x)      the same readings in other rows
    rms of all rows but k <= FEW_ROWS    < FEW_ROWS_SHARE rms of these k, weak readings weighed by their noise
    rms(x - g)                           < GAIN_SHARE |g|, with g the mean of a drive's or a measurement's rows

This needs no model. On a sheet that holds still, bent or touched, with noise of 0.3 %, it shows two rows whose readings
are more than 7 % apart; on the flat sheet those of 5 %.

Three kinds of failure do something that no touch does: a shorted pair of neighbours reads zero, exchanged neighbours
read the reverse, a loose contact jumps from frame to frame in all its rows and in no others. Several frames are
examined together because most of the cost is overhead: four cost little more than one.
"""

from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.health.imputation import Array
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS, TABLE

DEGREES_OF_FREEDOM: Final = 2.0
"""Of the t distribution whose conditional gives the surprise: touches are far more varied than a Gaussian allows."""

SHORTED_RATIO: Final = 0.01
"""A pair that reads less than this of its reference is shorted: the heaviest touches leave 0.02."""

OPEN_RATIO: Final = 0.05
"""Its neighbours read more than this: a detached electrode silences both of its pairs."""

REVERSED_RATIO: Final = -0.2
"""A pair whose rows, weighted by their size, read less than this is reversed; a sheet never reads below 0."""

JUMP_SIGMAS: Final = 4.0
"""Standard deviations of a row's second difference that count as a jump."""

JUMPING_ROWS: Final = 6
"""Rows of a pair's 13 that must jump at once: a loose contact's pair, in half of its draws or more."""

MAX_OTHER_SHARE: Final = 0.2
"""Share of the other electrodes' rows that may jump as well."""

OWN_ROWS: Final = 26
"""Rows of the table that drive or measure at one electrode."""

LEAST_UNLIKE: Final = 200.0
"""Surprise of two rows that is no sheet's: touches of all kinds and contrasts on random devices reach 165."""

LEAST_UNLIKE_WHOLE: Final = 15.0
"""The same of the whole frame per row, or the bundle's threshold if that is more; they reach 13."""

EXCHANGED_RATIO: Final = 3.0
"""D over D after the best exchange back: at most 1.8 for touches of all kinds on random devices; hundreds else."""

SORTED_SHARE: Final = 0.2
"""0.25 and more for touches that begin, move, grow or stay on simulated sheets, 0.37 on real gelatin."""

FEW_ROWS: Final = 4
FEW_ROWS_SHARE: Final = 0.06
"""0.08 and more, 0.1 on real gelatin."""

GAIN_SHARE: Final = 0.012
"""0.014 and more beside an electrode, 0.18 on real gelatin."""

LEAST_STEP: Final = 0.04
"""Least change, in log, that is looked at; rows of more noise than an eighth of that weigh less."""

SILENT_RATIO: Final = 0.005
"""Two rows of less noise that read less of their reference read nothing: touches of contrast 200 leave 0.014."""

STEP_FRAMES: Final = 200
"""Frames in a row that differ by a step, after which they are fit if they are fit otherwise: what went before may have
been wrong as well. One second at 200 frames/s."""

SILENT_STEP: Final = 4.0
"""A drive whose rows fall by as much is off, which has other causes."""

_SCALE: Final = DEGREES_OF_FREEDOM + N_ROWS - OWN_ROWS

PAIR_WRONG, JUMPING, WHOLE = slice(16, 32), slice(32, 48), 48
"""Columns of the votes behind those of 16 surprising electrodes: pairs (e, e + 1), electrodes, and the whole frame."""

N_VOTES: Final = 3 * N_ELECTRODES + 1

Votes = npt.NDArray[np.bool_]


@dataclass(slots=True, eq=False)
class Evidence:
    """The evidence of one frame for each electrode, for display."""

    surprise: Array
    """(16,) against the threshold of :class:`eitskin.health.electrodes.ElectrodeWatch`."""
    pair_ratio: Array
    """(16,) |V| of pair e, e + 1 over its reference, minus that of noise alone."""
    pair_sign: Array
    """(16,) the same with sign."""
    jumping: Array
    """(16,) share of the pair's rows that jumped."""
    total: float
    """Of the whole frame, per row."""


@dataclass(frozen=True, slots=True, eq=False)
class _Batch:
    """The evidence of n frames."""

    scores: Array
    """(n, 104) y"""
    total: Array
    """(n,) D"""
    silent: Array
    """(n, 16)"""
    sign: Array
    """(n, 16)"""
    jumps: Votes
    """(n, 104) rows that jumped."""


class Weigher:
    """Weighs frames against one reference.

    Args:
        mean: (104,) of l = log(V / V0).
        precision: (104, 104) P, with this device's noise.
        ratio_range: (2,) where V / V0 is cut off.
        reference_V: (104,) the reference that dV is taken against.
        sigma: (104,) relative standard deviation of its single frames.
        thresholds: (2,) an electrode's surprise and a whole frame's.
    """

    __slots__ = (
        "_before", "_first", "_fit", "_fit_heard", "_fit_low", "_harmless", "_heard", "_hum", "_inner", "_jump",
        "_last", "_loud", "_low_high", "_mean", "_members", "_mixed", "_one", "_other", "_own", "_pair_weight",
        "_pairs", "_precision", "_quiet", "_seen", "_sizes", "_square", "_step", "_steps", "_still", "_thresholds",
        "_trust", "of",
    )  # fmt: skip

    def __init__(
        self, mean: Array, precision: Array, ratio_range: Array, reference_V: Array, sigma: Array, thresholds: Array
    ) -> None:
        self._mean, self._precision = mean, precision
        self._low_high = (float(ratio_range[0]) - 1.0, float(ratio_range[1]) - 1.0)
        self._thresholds = (float(thresholds[0]), float(thresholds[1]))
        # D_e is never more than D, so a frame with a D below this surprises nowhere; 1 % is for rounding
        self._harmless = 0.99 * self._thresholds[0] * OWN_ROWS * DEGREES_OF_FREEDOM / _SCALE
        self.of = _rows_of_each()
        """(16, 26) rows of each electrode."""
        self._inner = _inner(precision, self.of)
        size = np.diag(precision)
        square = np.outer(size, size) - precision**2 + np.diag(np.full(N_ROWS, np.inf))
        self._first, self._mixed = size[None, :] / square, -2.0 * precision / square  # of P_gg^-1 of any two rows g
        self._trust = np.minimum(LEAST_STEP / 8.0 / np.maximum(sigma, 1e-9), 1.0)
        self._loud = np.maximum(LEAST_STEP / 8.0 / np.maximum(sigma, 1e-9), 1.0)
        self._heard, self._fit_heard = np.ones((2, N_ROWS))
        self._sizes = np.log(np.maximum(np.abs(reference_V), 1e-30))
        self._fit, self._one, self._other, self._step, self._square, self._still = np.zeros((6, N_ROWS))
        self._fit_low = 1.0
        """The least V / V0 of the last frame that was fit."""
        self._own = np.zeros(len(_MANY))
        self._quiet = sigma < SILENT_RATIO
        self._steps = 0
        """Frames that may yet differ by a step from the last one that was fit."""
        pairs = np.array([np.equal(TABLE, pair).any(axis=1) for pair in range(N_ELECTRODES)], dtype=np.float64)
        weight = pairs * np.abs(reference_V)
        self._pair_weight = np.ascontiguousarray((weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-30)).T)
        self._hum = np.sqrt(2.0 / np.pi) * sigma @ self._pair_weight  # (16,) what noise alone reads, in size
        members = np.zeros((N_ROWS, N_ELECTRODES))
        for electrode, rows in enumerate(self.of):
            members[rows, electrode] = 1.0
        self._pairs = pairs.sum(axis=1)  # (16,) rows of each pair
        self._members = np.concatenate([pairs.T, members, np.ones((N_ROWS, 1))], axis=1)  # (104, 33)
        self._jump = JUMP_SIGMAS * np.sqrt(6.0) * sigma  # a second difference has six times the variance
        self._before = np.zeros((2, N_ROWS))
        self._seen = 0
        nothing = np.zeros((1, N_ELECTRODES))
        rows = np.zeros((1, N_ROWS))
        self._last = _Batch(rows, np.zeros(1), nothing, nothing, rows.astype(np.bool_))

    def weigh(self, raw: npt.NDArray[np.float32], change: npt.NDArray[np.float32], in_use: Votes) -> Votes:
        """Return (n, 49) votes of n frames in a row, the frames after those of the last call.

        Args:
            raw: (n, 104) dV as measured.
            change: (n, 104) the same, with known faults corrected.
            in_use: (16,) pairs of which both electrodes are in use.
        """
        frames = np.concatenate([self._before, raw])  # (n + 2, 104), in float64
        self._before = frames[-2:]
        ratio = frames[2:] + 1.0
        silent = sign = ratio @ self._pair_weight
        if ratio.min() < 0.0:
            # Of noise alone sizes add up where readings cancel; of exchanged wires readings cancel where sizes add up.
            silent = np.maximum(np.abs(ratio) @ self._pair_weight - self._hum, np.abs(sign))
        steps = frames[1:] - frames[:-1]
        second = np.abs(steps[1:] - steps[:-1])
        jumps = second > self._jump
        if jumps.any():
            jumps &= second > self._jump * np.abs(ratio)  # a row that reads more moves more
        scores, logs = self.scores(change)
        found = _Batch(scores, np.einsum("nr,nr->n", logs, scores), silent, sign, jumps)
        if self._seen < 2:
            jumps[: 2 - self._seen] = False  # there is no second difference yet
        self._seen += len(raw)
        self._last = found
        votes = np.zeros((len(raw), N_VOTES), dtype=np.bool_)
        largest = float(found.total.max())
        if not largest <= self._harmless:
            surprise = self._surprise(found.scores, found.total)
            each, worst = np.arange(len(raw)), surprise.argmax(axis=1)
            votes[each, worst] = surprise[each, worst] > self._thresholds[0]
        if found.silent.min() < SHORTED_RATIO or found.sign.min() < REVERSED_RATIO:
            beside = np.minimum(found.silent[:, _BEFORE], found.silent[:, _AFTER])
            nothing = found.silent < SHORTED_RATIO
            shorted = nothing & (beside > OPEN_RATIO)
            votes[:, :N_ELECTRODES] |= nothing & nothing[:, _BEFORE] & in_use & in_use[_BEFORE]
            votes[:, PAIR_WRONG] = (shorted | (found.sign < REVERSED_RATIO)) & in_use
        if jumps.any():
            sums = jumps @ self._members
            of_pair, own, every = sums[:, :16], sums[:, 16:32], sums[:, 32:]
            both = np.minimum(of_pair, of_pair[:, _BEFORE]) >= JUMPING_ROWS  # pairs e - 1 and e
            votes[:, JUMPING] = both & (every - own <= MAX_OTHER_SHARE * (N_ROWS - OWN_ROWS))
        if not largest <= self._thresholds[1] * N_ROWS:
            votes[:, WHOLE] = found.total / N_ROWS > self._thresholds[1]
        return votes

    def evidence(self, row: int = -1) -> Evidence:
        """Return the evidence of one of the last frames."""
        last = self._last
        jumping = (last.jumps[row] @ self._members)[:16] / self._pairs
        surprise = self._surprise(last.scores, last.total)[row]
        return Evidence(surprise, last.silent[row], last.sign[row], jumping, float(last.total[row]) / N_ROWS)

    def surprise(self, change: npt.NDArray[np.floating]) -> tuple[Array, Array]:
        """Return the (n, 16) surprises of (n, 104) dV, and (n,) those of the whole frames per row."""
        scores, logs = self.scores(change)
        total = np.einsum("nr,nr->n", logs, scores)
        return self._surprise(scores, total), np.asarray(total / N_ROWS)

    def is_mixed_up(self, change: npt.NDArray[np.floating], *, look: bool) -> bool:
        """Return whether (104,) dV differs from the last fit frame as no sheet moves; if not, it is fit from now on.

        Args:
            change: (104,) dV.
            look: Whether the difference from the reference is looked at, too.
        """
        step = self._step
        np.subtract(change, self._fit, out=step)
        np.multiply(step, self._trust, out=step)
        low = 1.0 + float(change.min())
        least = LEAST_STEP * min(low, self._fit_low)  # readings that move less do not move logarithms by LEAST_STEP
        small = max(step.max(), -step.min()) < least
        if look or not small:
            after, heard = self._logs_of(change, self._one, self._heard)
            if look and self._is_no_move(after, self._still, heard):
                return True
            if self._steps and not small:
                before, self._fit_heard = self._logs_of(self._fit, self._other, self._fit_heard)
                if self._is_no_move(after, before, np.minimum(heard, self._fit_heard, out=self._fit_heard)):
                    self._steps -= 1
                    return True
        np.copyto(self._fit, change)
        self._fit_low, self._steps = low, STEP_FRAMES
        return False

    def _logs_of(self, change: npt.NDArray[np.floating], logs: Array, heard: Array) -> tuple[Array, Array]:
        """Fill in and return (104,) l weighed by trust, and the weights where few rows move."""
        np.maximum(change, self._low_high[0], out=logs)
        np.minimum(logs, self._low_high[1], out=logs)
        np.add(logs, 1.0, out=heard)
        np.multiply(heard, self._loud, out=heard)
        np.minimum(heard, 1.0, out=heard)
        np.log1p(logs, out=logs)
        np.multiply(logs, self._trust, out=logs)
        return logs, heard

    def forget_step(self) -> None:
        """Compare the next frame with none before it."""
        self._steps = 0

    def _is_no_move(self, after: Array, before: Array, heard: Array) -> bool:
        """Return whether no touch or bend leads from one (104,) l to another, both weighed by trust.

        Args:
            after: (104,) l.
            before: (104,) l.
            heard: (104,) weights where few rows move. A touch leaves a row fewer counts, but not less noise.
        """
        change, square = self._step, self._square
        np.subtract(after, before, out=change)
        if max(change.max(), -change.min()) < LEAST_STEP:
            return False
        np.multiply(change, heard, out=square)
        np.multiply(square, square, out=square)
        few_total, total = float(square.sum()), float(change.dot(change))
        square.sort()
        np.add.accumulate(square[: -FEW_ROWS - 1 : -1], out=self._own[:FEW_ROWS])
        np.matmul(change, _GAINS, out=self._own[FEW_ROWS:])
        np.multiply(self._own[FEW_ROWS:], self._own[FEW_ROWS:], out=self._own[FEW_ROWS:])
        for own, many, share in zip(self._own.tolist(), _MANY, _SHARES, strict=True):
            rest = (few_total if share == FEW_ROWS_SHARE**2 else total) - own
            if own / many > LEAST_STEP**2 and rest / (N_ROWS - many) < share * own / many:
                return bool(many <= FEW_ROWS or own / many < SILENT_STEP**2)
        if total < (LEAST_STEP / 2.0) ** 2 * N_ROWS:
            return False
        np.add(after, self._sizes, out=change)
        np.add(before, self._sizes, out=square)
        change.sort()
        square.sort()
        np.subtract(change, square, out=change)
        return float(change.dot(change)) < SORTED_SHARE**2 * total

    def is_unlike(self, change: npt.NDArray[np.floating]) -> bool:
        """Return whether rows of (104,) dV fit the others less than on any sheet, or some read nothing."""
        if np.count_nonzero((np.abs(change + 1.0) < SILENT_RATIO) & self._quiet) > 1:
            return True
        scores, logs = (one[0] for one in self.scores(change[None]))
        total = float(logs @ scores)
        if total > max(LEAST_UNLIKE_WHOLE, self._thresholds[1]) * N_ROWS:
            return True
        if not total > LEAST_UNLIKE * 2.0 * DEGREES_OF_FREEDOM / N_ROWS:
            return False  # less than what surprises most easily
        size = self._mean + self._sizes
        back = (logs + size)[_EXCHANGES] - size
        if float(np.einsum("nr,nr->n", back @ self._precision, back).min()) * EXCHANGED_RATIO < total:
            return True
        two = self._first * np.square(scores)[:, None]
        own = float((two + two.T + self._mixed * np.outer(scores, scores)).max())  # y_g^T P_gg^-1 y_g
        rest = (max(total - own, 0.0) + DEGREES_OF_FREEDOM) / (DEGREES_OF_FREEDOM + N_ROWS - 2.0)
        return bool(own / 2.0 > LEAST_UNLIKE * rest)

    def _surprise(self, scores: Array, total: Array) -> Array:
        """Return the (n, 16) surprises of electrodes."""
        part = np.take(scores.T, self.of, axis=0)  # (16, 26, n)
        own = np.einsum("ern,ern->ne", np.matmul(self._inner, part), part)
        rest = np.maximum(total[:, None] - own, 0.0)
        return np.asarray(own * (_SCALE / OWN_ROWS) / (rest + DEGREES_OF_FREEDOM))

    def scores(self, change: npt.NDArray[np.floating]) -> tuple[Array, Array]:
        """Return (n, 104) y and l - mean of (n, 104) dV."""
        logs = np.maximum(change, self._low_high[0], dtype=np.float64)  # np.clip takes three times as long
        np.minimum(logs, self._low_high[1], out=logs)
        np.log1p(logs, out=logs)
        np.subtract(logs, self._mean, out=logs)
        return logs @ self._precision, logs


@cache
def _rows_of_each() -> npt.NDArray[np.intp]:
    return np.array([np.flatnonzero(rows_of((electrode,))) for electrode in range(N_ELECTRODES)])


def _inner(precision: Array, of: npt.NDArray[np.intp]) -> Array:
    """Return (k, 26, 26) P_gg^-1 of k groups of rows."""
    return np.asarray(np.linalg.inv(precision[of[:, :, None], of[:, None, :]]))


def _columns(column: int) -> Array:
    """Return (104, k) unit vectors, each of the rows with one drive (0) or measurement (1)."""
    same = np.equal(TABLE[:, column, None], np.unique(TABLE[:, column])).astype(np.float64)
    return np.asarray(same / np.sqrt(same.sum(axis=0)))


def _exchanges() -> npt.NDArray[np.intp]:
    """Return (182, 104) orders of rows in which two drives or two measurements are exchanged."""
    orders = []
    for column in (0, 1):
        groups = [np.flatnonzero(TABLE[:, column] == k) for k in np.unique(TABLE[:, column])]
        for one, other in combinations(groups, 2):
            order, many = np.arange(N_ROWS), min(len(one), len(other))
            order[one[:many]], order[other[:many]] = other[:many], one[:many]
            orders.append(order)
    return np.array(orders)


_EXCHANGES: Final = _exchanges()
_GAINS: Final = np.hstack([_columns(0), _columns(1)])
_MANY: Final = [*range(1, FEW_ROWS + 1), *(_GAINS > 0.0).sum(axis=0).tolist()]
_SHARES: Final = [FEW_ROWS_SHARE**2] * FEW_ROWS + [GAIN_SHARE**2] * (len(_MANY) - FEW_ROWS)

_BEFORE: Final = np.roll(np.arange(N_ELECTRODES), 1)
_AFTER: Final = np.roll(np.arange(N_ELECTRODES), -1)
