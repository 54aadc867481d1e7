"""Finds readings that come again: rows that hang, frames that come again.

A reading of a living front end is that of the frame before by chance alone. With s the spread of a row's single frames
in counts, by the reference ::

    p = 1 / (2 sqrt(pi) s)        s goes with V / V0 where a touch lowers the row

That is too little where the spread comes from slow changes, so p is at least what the row did before, of which the
reference counts as ``BELIEVED_FRAMES``. A row hangs if it repeats n times in a row and p^n < exp(-SURPRISE), and so do
all rows that have repeated as long. Rows may share their noise, so a frame that repeats as a whole is judged by its
best row. A coarse converter has p = 1 and is never blamed, and a row of no count is that of an electrode that is off.
"""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

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


def ranges(rows: npt.NDArray[np.intp]) -> str:
    """Return ascending numbers of rows as text: ``0-12, 40``."""
    runs = np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1)
    return ", ".join(f"{run[0]}" if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)


class Repeats:
    """Holds each frame against the one before; an honest frame allocates nothing.

    Args:
        rows: Of a frame.
    """

    __slots__ = (
        "_before", "_count", "_frames", "_limit", "_over", "_patience", "_running", "_runs", "_same", "_size",
        "_spread", "_whole", "hanging",
    )  # fmt: skip

    def __init__(self, rows: int) -> None:
        self._before, self._runs, self._count, self._spread = np.zeros((4, rows))
        self._size, self._patience = np.ones(rows), np.full(rows, np.inf)
        self._same, self._over = np.zeros((2, rows), dtype=np.bool_)
        self._limit, self._frames, self._whole, self._running = math.inf, 0.0, 0, False
        self.hanging: Rows = np.zeros(rows, dtype=np.bool_)
        """(rows,) those that hang in the frame judged last."""

    def use_reference(self, size: Array, spread: Array, limit: float) -> None:
        """Judge by another reference from the next frame on.

        Args:
            size: (rows,) of the reference, in counts.
            spread: (rows,) standard deviation of single frames, in counts.
            limit: Largest count of the converter.
        """
        self._size, self._spread, self._limit = np.maximum(np.abs(size), 1e-30), spread, limit
        with np.errstate(divide="ignore"):
            self._patience = np.ceil(SURPRISE / evidence(spread))
        self._runs[:] = 0.0

    def add(self, counts: npt.NDArray[np.number]) -> bool:
        """Take a frame, and return whether it is worth a judgement.

        Args:
            counts: (rows,)
        """
        np.equal(counts, self._before, out=self._same)
        np.copyto(self._before, counts)
        many = int(np.count_nonzero(self._same))
        self._frames += 1.0
        if not (many or self._running):
            return False
        if self._frames > REMEMBERED_FRAMES:
            self._frames *= 0.5
            np.multiply(self._count, 0.5, out=self._count)
        whole = many > MOST_SHARE * len(self._same)
        if self._whole and not whole:  # it moves again; a row that repeats once more does so by chance
            self._runs.fill(0.0)
        self._whole, self._running = self._whole + 1 if whole else 0, many > 0
        np.add(self._runs, self._same, out=self._runs)
        np.multiply(self._runs, self._same, out=self._runs)
        np.add(self._count, self._same, out=self._count)
        np.greater_equal(self._runs, self._patience, out=self._over)
        return int(np.count_nonzero(self._over)) > 0

    def is_old(self, counts: npt.NDArray[np.number], times: int, frames: int) -> bool:
        """Return whether the frame added last comes again as a whole, and find the rows that hang if it does not.

        Args:
            counts: (rows,) of it.
            times: How many frames in a row, this one included, are those of old ones.
            frames: How many old ones they were compared with.
        """
        size = np.abs(counts)  # what is cut off has no noise
        spread = self._spread * np.where(size < self._limit, np.minimum(size / self._size, 1.0), 0.0)
        chance, runs = np.exp(-evidence(spread)), np.minimum(self._runs, self._count)
        before = np.maximum(self._frames - runs, 0.0)
        repeated = (self._count - runs + BELIEVED_FRAMES * chance) / (before + BELIEVED_FRAMES)
        found = -np.log(np.maximum(chance, np.minimum(repeated, 1.0)))
        sure, best = self._runs * found >= SURPRISE, float(found.max(initial=0.0))
        longest = self._runs[sure].min(initial=np.inf)
        self.hanging = (self._runs >= longest) & (self._runs * found >= SURPRISE / 4.0) & (self._whole == 0)
        return self._whole * best >= SURPRISE or times * best >= SURPRISE + math.log(frames)
