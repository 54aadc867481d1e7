"""Finds readings that come again: rows that hang, frames that are partly old, rings of old frames.

A reading of a living front end is that of the frame before by chance alone. With s the spread of a row's single frames
in counts, by the reference ::

    p = 1 / (2 sqrt(pi) s)        s goes with V / V0 where a touch lowers the row

That is too little where the spread comes from slow changes, so p is at least what the row did before, of which the
reference counts as ``BELIEVED_FRAMES``.

    a row hangs              n repetitions in a row:    p^n < exp(-SURPRISE)
    a frame is partly old    1/2 sum of ln(1 / p) over rows that repeat > SURPRISE + sum of ln(1 - p + sqrt(p)) over all

The second is Chernoff's bound on so many rows repeating at once, for the noise that rows do not share. A coarse
converter has p = 1 and is never blamed, and a row of no count is that of an electrode that is off.
"""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.noise_law import MIN_OWN_SHARE, own_sd

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.bool_]

SURPRISE: Final = 28.0
"""-ln of a millionth of a millionth: what a repetition must be by chance."""

STEPPING: Final = 0.5
"""Square counts that a row without noise may vary by: between two counts by a quarter, and by a slow step."""

MOST_SHARE: Final = 0.75
"""Share of the rows above which the frame as a whole repeats."""

BELIEVED_FRAMES: Final = 32
REMEMBERED_FRAMES: Final = 1024
"""Frames over which repetitions are counted."""

_WIDTH: Final = 2.0 * math.sqrt(math.pi)


def evidence(spread_counts: Array) -> Array:
    """Return (n,) -ln of the chance that a row repeats.

    Args:
        spread_counts: (n,) standard deviation of each row's single frames, in counts.
    """
    noise = np.sqrt(np.maximum(spread_counts**2 - STEPPING, 0.0))
    return np.asarray(np.log(np.maximum(_WIDTH * noise, 1.0)))


def surprise(own: Array, same: Rows) -> float:
    """Return -ln of the largest chance that some rows repeat in one frame.

    Args:
        own: (n,) evidence of each row, for the noise that it does not share.
        same: (n,) the rows that repeat.
    """
    return 0.5 * float(own[same].sum()) - float(np.log(1.0 - np.exp(-own) + np.exp(-0.5 * own)).sum())


def tells(own: Array) -> bool:
    """Return whether a frame all rows of which repeat is no chance.

    Args:
        own: (n,) the part of each row's spread that it does not share, in counts.
    """
    return surprise(evidence(own), np.ones(len(own), dtype=np.bool_)) >= SURPRISE


def ranges(rows: npt.NDArray[np.intp]) -> str:
    """Return ascending numbers of rows as text: ``0-12, 40``."""
    runs = np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1)
    return ", ".join(f"{run[0]}" if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)


def own_counts(spread_V: Array, shared_V: Array | None, step_V: float) -> Array:
    """Return (n,) the part of the spread that rows do not share, in counts.

    Args:
        spread_V: (n,) V, standard deviation of single frames.
        shared_V: (n, k) V, the part that rows share; None for none.
        step_V: Of a count.
    """
    if shared_V is None:
        return spread_V / step_V
    own = own_sd(spread_V, shared_V)
    return np.where(own**2 > 1.1 * MIN_OWN_SHARE * spread_V**2, own, 0.0) / step_V  # the least share is a bound


class Repeats:
    """Holds each frame against the one before; an honest frame allocates nothing.

    Args:
        rows: Of a frame.
    """

    __slots__ = (
        "_before", "_count", "_evidence", "_evidence_of_own", "_few", "_frames", "_limit", "_most", "_over", "_own",
        "_patience", "_running", "_runs", "_same", "_size", "_spread", "hanging",
    )  # fmt: skip

    def __init__(self, rows: int) -> None:
        self._before, self._runs, self._count = np.zeros((3, rows))
        self._size, self._frames = np.ones(rows), 0.0
        self._same, self._over = np.zeros((2, rows), dtype=np.bool_)
        self._patience = np.full(rows, np.inf)
        self._spread = self._own = np.zeros(rows)
        self._few, self._limit, self._running, self._most = rows + 1, math.inf, False, False
        self._evidence = self._evidence_of_own = np.zeros(rows)
        self.hanging: Rows = np.zeros(rows, dtype=np.bool_)
        """(rows,) those that hang in the frame judged last."""

    def use_reference(self, size: Array, spread: Array, own: Array, limit: float) -> None:
        """Judge by another reference from the next frame on.

        Args:
            size: (rows,) of the reference, in counts.
            spread: (rows,) standard deviation of single frames, in counts.
            own: (rows,) the part of it that rows do not share.
            limit: Largest count of the converter.
        """
        self._size, self._spread, self._own, self._limit = np.maximum(np.abs(size), 1e-30), spread, own, limit
        with np.errstate(divide="ignore"):
            self._patience = np.ceil(SURPRISE / evidence(spread))
        strongest = np.sort(evidence(own))[::-1]
        every = np.ones(len(own), dtype=np.bool_)
        bound = SURPRISE + 0.5 * float(strongest.sum()) - surprise(strongest, every)
        self._few = int(np.searchsorted(0.5 * np.cumsum(strongest), bound)) + 1
        self._runs[:] = 0.0

    def add(self, counts: npt.NDArray[np.number]) -> bool:
        """Take a frame, and return whether it is worth a judgement.

        Args:
            counts: (rows,)
        """
        np.equal(counts, self._before, out=self._same)
        np.copyto(self._before, counts)
        many = np.count_nonzero(self._same)
        self._frames += 1.0
        if not (many or self._running):
            return False
        if self._frames > REMEMBERED_FRAMES:
            self._frames *= 0.5
            np.multiply(self._count, 0.5, out=self._count)
        most, self._most = self._most, many > MOST_SHARE * len(self._same)
        if most and not self._most:  # it moves again; a row that repeats once more does so by chance
            self._runs.fill(0.0)
        self._running = many > 0
        np.add(self._runs, self._same, out=self._runs)
        np.multiply(self._runs, self._same, out=self._runs)
        np.add(self._count, self._same, out=self._count)
        np.greater_equal(self._runs, self._patience, out=self._over)
        return bool(many >= self._few or np.count_nonzero(self._over) > 0)

    def judge(self, counts: npt.NDArray[np.number]) -> None:
        """Find the rows that hang in the frame added last, and the evidence for the other judgements.

        Args:
            counts: (rows,) of it.
        """
        size = np.abs(counts)  # what is cut off has no noise
        share = np.where(size < self._limit, np.minimum(size / self._size, 1.0), 0.0)
        self._evidence, self._evidence_of_own = self._of(self._spread * share), self._of(self._own * share)
        self.hanging = self._runs * self._evidence >= SURPRISE

    def is_old(self, rows: Rows) -> bool:
        """Return whether a judged frame is partly old.

        Args:
            rows: (rows,) those that count; others are filled in whatever they read.
        """
        return surprise(self._evidence_of_own, self._same & rows) >= SURPRISE

    def come_again(self, times: int, frames: int) -> bool:
        """Return whether a judged frame, all rows of which are those of an old one, is no chance.

        Args:
            times: How many such frames came in a row, this one included.
            frames: How many old ones it was compared with.
        """
        alone = surprise(self._evidence_of_own, np.ones(len(self._same), dtype=np.bool_))
        again = max(alone, times * float(self._evidence.max(initial=0.0)))
        return times > 0 and again >= SURPRISE + math.log(frames)

    def _of(self, spread: Array) -> Array:
        """Return (rows,) evidence of spreads and of how often rows repeated before their present run."""
        chance, runs = np.exp(-evidence(spread)), np.minimum(self._runs, self._count)
        before = np.maximum(self._frames - runs, 0.0)
        repeated = (self._count - runs + BELIEVED_FRAMES * chance) / (before + BELIEVED_FRAMES)
        return np.asarray(-np.log(np.maximum(chance, np.minimum(repeated, 1.0))))
