"""Evidence from frames for each electrode's failure: numbers, and a vote of each frame for each suspicion.

An electrode's *surprise* divides the distance of its rows from their prediction by the other rows' distance from the
mean. So a heavy touch, which moves all rows, surprises at no particular electrode::

    D_e = y_e^T P_ee^-1 y_e          surprise_e = (D_e / 26) / ((2 + D - D_e) / (2 + 78))      D = (l - mean)^T y

Rows of two pairs (e, e + 1) that have nothing to do with each other surprise the same way, by which columns are found
that were exchanged, or one drive that is not the one that it should be: of all touches and bends only one in ten
thousand surprises by ``LEAST_UNLIKE``, or by the bundle's own threshold if that is more.

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

LEAST_UNLIKE: Final = 150.0
"""Surprise of two pairs: contrasts of 0.2 to 4, of a kind that the bundle does not know either, reach 110."""

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
        "_before", "_harmless", "_hum", "_inner", "_inner_of_two", "_jump", "_last", "_low_high", "_mean", "_members",
        "_one", "_pair_weight", "_pairs", "_precision", "_seen", "_thresholds", "of",
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
        self._inner_of_two: Array | None = None
        """Made when it is first asked for; it takes 20 ms."""
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
        self._before, self._one = np.zeros((2, 2, N_ROWS))
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
            shorted = (found.silent < SHORTED_RATIO) & (beside > OPEN_RATIO)
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

    def is_unlike(self, change: npt.NDArray[np.floating]) -> bool:
        """Return whether the rows of some two pairs fit the others in (104,) dV less than on any sheet."""
        limit = max(LEAST_UNLIKE, self._thresholds[0])
        scores, logs = self._one  # as of :meth:`scores`, which makes arrays
        np.maximum(change, self._low_high[0], out=logs)
        np.minimum(logs, self._low_high[1], out=logs)
        np.log1p(logs, out=logs)
        np.subtract(logs, self._mean, out=logs)
        np.matmul(logs, self._precision, out=scores)
        total = float(logs.dot(scores))
        if not total * _SCALE > limit * OWN_ROWS * DEGREES_OF_FREEDOM:
            return False
        if self._inner_of_two is None:
            self._inner_of_two = _inner(self._precision, _OF_TWO)
        return bool(self._surprise(scores[None], np.array([total]), _OF_TWO, self._inner_of_two).max() > limit)

    def _surprise(
        self, scores: Array, total: Array, of: npt.NDArray[np.intp] | None = None, inner: Array | None = None
    ) -> Array:
        """Return the (n, k) surprises of k groups of rows; of electrodes where no other are given."""
        of, inner = (self.of, self._inner) if of is None or inner is None else (of, inner)
        part = np.take(scores.T, of, axis=0)  # (k, 26, n)
        own = np.einsum("ern,ern->ne", np.matmul(inner, part), part)
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


def _rows_of_two() -> npt.NDArray[np.intp]:
    """Return (120, 26) the rows of every two pairs, and any other row where these share one."""
    both = [np.equal(TABLE[:, :, None], two).any(axis=(1, 2)) for two in combinations(range(N_ELECTRODES), 2)]
    return np.argsort(~np.array(both), axis=1, kind="stable")[:, :OWN_ROWS]


_OF_TWO: Final = _rows_of_two()

_BEFORE: Final = np.roll(np.arange(N_ELECTRODES), 1)
_AFTER: Final = np.roll(np.arange(N_ELECTRODES), -1)
