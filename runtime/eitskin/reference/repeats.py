"""Finds readings that come again: rows that hang, frames that come again.

A reading of a living front end is that of the frame before by chance alone. With s the spread of a row's single frames
in counts, by the reference ::

    p = 1 / (2 sqrt(pi) s)        s goes with V / V0 where a touch lowers the row

That is too little where the spread comes from slow changes, so p is at least what the row did before, of which the
reference counts as ``BELIEVED_FRAMES``. A row hangs if it repeats n times in a row and p^n < exp(-SURPRISE), and so do
all rows that have repeated as long. A coarse converter has p = 1 and is never blamed, and a row of no count is that of
an electrode that is off.

Rows of a ring of old frames repeat at one lag. Every ``LOOK_FRAMES`` frames a frame is held against each of the last
``RING_FRAMES``, and the looks in a row are counted by lag and row; of that many lags one may repeat by chance.

Frames that are sent several times, or renewed in part, repeat now and then, in many rows. Rows may share their noise,
so such a frame is as unlikely as its best row, or if not all rows repeat, as the best of half of those that do. With q
= ``REPEATING`` the share of such frames, these add ln(q / p), others ln((1 - q) / (1 - p)), and the sum, at least 0, is
below ``SURPRISE``.
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

MANY_SHARE: Final = 0.25
"""Share of the rows above which a frame repeats in part."""

REPEATING: Final = 1.0 / 3.0

QUIET_FRAMES: Final = 8
"""Frames in a row that do not repeat, after which those before do not count."""

RING_FRAMES: Final = 256
LOOK_FRAMES: Final = 4
MOST_LOOKS: Final = 250
"""Up to which looks are counted."""

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
    """Holds each frame against those before; an honest frame allocates nothing.

    Args:
        rows: Of a frame.
    """

    __slots__ = (
        "_before", "_count", "_evidence", "_frames", "_in_ring", "_lags", "_limit", "_looks", "_looks_needed",
        "_matches", "_old", "_over", "_patience", "_quiet", "_ring", "_ringing", "_running", "_runs", "_same", "_score",
        "_size", "_spread", "_taken", "_whole", "hanging",
    )  # fmt: skip

    def __init__(self, rows: int) -> None:
        self._before, self._runs, self._count, self._spread, self._in_ring, self._evidence = np.zeros((6, rows))
        self._size, self._patience = np.ones(rows), np.full(rows, np.inf)
        self._looks_needed = np.full(rows, MOST_LOOKS + 1, dtype=np.uint8)
        self._same = np.zeros(rows, dtype=np.bool_)
        self._ring = np.full((2 * RING_FRAMES, rows), np.nan)
        """The last frames, each twice, the newest first from where it was put."""
        self._looks = np.zeros((RING_FRAMES - 1, rows), dtype=np.uint8)
        """Looks in a row at which a row repeated, by lag."""
        self._matches = np.zeros((RING_FRAMES - 1, rows), dtype=np.bool_)
        self._over, self._lags = np.zeros(rows, dtype=np.bool_), np.zeros(RING_FRAMES - 1, dtype=np.bool_)
        self._limit, self._frames, self._score, self._old = math.inf, 0.0, 0.0, False
        self._taken, self._quiet, self._whole = 0, 0, 0
        self._running = self._ringing = False
        """Whether rows repeated in the last frame, and whether some are in a ring."""
        self.hanging: Rows = np.zeros(rows, dtype=np.bool_)
        """(rows,) those that hang in the frame judged last."""

    def use_reference(self, size: Array, spread: Array, limit: float) -> None:
        """Judge by another reference from the next frame on.

        Args:
            size: (rows,) of the reference, in the unit of the frames.
            spread: (rows,) standard deviation of single frames, in counts.
            limit: Largest reading of the converter, in the unit of the frames.
        """
        self._size, self._spread, self._limit = np.maximum(np.abs(size), 1e-30), spread, limit
        self._evidence = np.sort(evidence(spread))[::-1]
        with np.errstate(divide="ignore"):
            self._patience = np.ceil(SURPRISE / evidence(spread))
        self._looks_needed = np.minimum(self._patience + 1.0, MOST_LOOKS + 1.0).astype(np.uint8)
        self.forget()

    def forget(self) -> None:
        """Hold the next frames against none before them."""
        self._ring[:] = np.nan
        self._runs[:] = self._looks[:] = self._in_ring[:] = self._score = 0
        self._running = self._ringing = False

    def add(self, counts: npt.NDArray[np.number]) -> bool:
        """Take a frame, and return whether it is worth a judgement.

        Args:
            counts: (rows,)
        """
        np.equal(counts, self._before, out=self._same)
        np.copyto(self._before, counts)
        many = int(np.count_nonzero(self._same))
        self._frames += 1.0
        self._look(counts)
        if not (many or self._running or self._ringing or self._score):
            self._quiet += 1
            return False
        if self._frames > REMEMBERED_FRAMES:
            self._frames *= 0.5
            np.multiply(self._count, 0.5, out=self._count)
        whole = many > MOST_SHARE * len(self._same)
        if self._whole and not whole:  # it moves again; a row that repeats once more does so by chance
            self._runs.fill(0.0)
        self._whole, self._running = self._whole + 1 if whole else 0, many > 0
        self._add_to_score(many)
        np.add(self._runs, self._same, out=self._runs)
        np.multiply(self._runs, self._same, out=self._runs)
        np.add(self._count, self._same, out=self._count)
        np.greater_equal(self._runs, self._patience, out=self._over)
        return bool(self._ringing or self._score >= SURPRISE or self._over.any())

    def _add_to_score(self, many: int) -> None:
        """Count a frame that repeats in many rows, or one that does not."""
        rows = len(self._same)
        found = self._evidence[0 if many == rows else rows - 1 - many // 2] if rows else 0.0
        more = found + math.log(REPEATING)
        self._quiet += 1
        if many > MANY_SHARE * rows and more > 0.0:
            self._quiet = 0
        elif self._quiet < QUIET_FRAMES:
            more = math.log(1.0 - REPEATING)
        else:
            more = -self._score
        self._score = max(self._score + more, 0.0)

    def _look(self, counts: npt.NDArray[np.number]) -> None:
        """Hold one frame of ``LOOK_FRAMES``, or each of a ring, against the last ones."""
        at = RING_FRAMES - 1 - self._taken % RING_FRAMES
        self._ring[at] = self._ring[at + RING_FRAMES] = counts
        self._taken += 1
        if self._taken % LOOK_FRAMES == 0 or self._ringing:
            np.equal(self._ring[at + 1 : at + RING_FRAMES], counts, out=self._matches)
            np.add(self._looks, 1, out=self._looks)
            np.multiply(self._looks, self._matches.view(np.uint8), out=self._looks)
            np.minimum(self._looks, MOST_LOOKS, out=self._looks)
            before = np.count_nonzero(self._in_ring)
            np.greater_equal(self._looks, self._looks_needed, out=self._matches)
            np.logical_or.reduce(self._matches, axis=1, out=self._lags)
            lag = int(np.argmax(self._lags))
            self._in_ring[:] = self._looks[lag] if self._lags[lag] else 0.0
            if np.count_nonzero(self._in_ring) < before / 2:  # it is over; rows that still repeat do so by chance
                self._looks[:] = self._in_ring[:] = 0
            self._ringing = bool(self._in_ring.any())

    def is_old(self, counts: npt.NDArray[np.number], times: int, frames: int) -> bool:
        """Return whether the frame added last comes again as a whole, and find the rows that hang if it does not.

        Args:
            counts: (rows,) of it.
            times: How many frames in a row, this one included, are those of old ones.
            frames: How many old ones they were compared with.
        """
        size = np.abs(counts)  # what is cut off has no noise
        spread = self._spread * np.where(size < self._limit, np.minimum(size / self._size, 1.0), 0.0)
        by_noise = evidence(spread)
        chance, runs = np.exp(-by_noise), np.minimum(self._runs, self._count)
        before = np.maximum(self._frames - runs, 0.0)
        repeated = (self._count - runs + BELIEVED_FRAMES * chance) / (before + BELIEVED_FRAMES)
        found = -np.log(np.maximum(chance, np.minimum(repeated, 1.0)))
        self.hanging = np.zeros_like(self.hanging)
        for run, least in ((self._runs * (self._whole == 0), SURPRISE), (self._in_ring, SURPRISE + _LOG_LAGS)):
            sure = run * found >= least
            self.hanging |= (run >= run[sure].min(initial=np.inf)) & (run * found >= SURPRISE / 4.0)
        if self.hanging.any():
            self._score = 0.0  # they are the rows that repeat
        weaker = float(by_noise.sum()) / max(float(self._evidence.sum()), 1e-30)
        best = float(found.max(initial=0.0))
        was_old, self._old = self._old, bool(self._quiet == 0 and self._score * weaker >= SURPRISE)
        self._old |= self._whole * best >= SURPRISE or times * best >= SURPRISE + math.log(frames)
        if was_old and not self._old:  # old frames say nothing of how often honest rows repeat
            self._count[:] = self._frames = 0.0
        return self._old


_LOG_LAGS: Final = math.log(RING_FRAMES)
