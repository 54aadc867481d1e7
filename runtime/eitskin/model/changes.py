"""A press that is too faint for one frame is a change against what the same sheet read untouched.

Most of what a gate must allow for, the device and its bend, is the same from one frame to the next. A gate of matched
filters is linear up to its first ReLU, with w the whitened logarithms and f what the filters make of them ::

    p = (w, f)      touched: max f > c (mean |w| + a)

so the same filters judge a change of p, and what the two frames share is gone from it. Two means are remembered, of
untouched frames alone: ``recent`` of the last ``FAST``, ``base`` of the last ``SLOW`` ::

    p - recent      a press that comes on at once; a bend has hardly moved since        limit NEW c
    recent - base   one that takes seconds; the sheet may have been bent anew           limit c
    p - base        one that was found: held against the frames before it, for hours    limit HELD c

While a touch lies there nothing is learned. It is gone when ``GONE`` frames in a row are below the limit, or below
``LEFT`` of its own strength: real sheets keep that much of a press for a while. Filters of one sign tell the end of a
touch, which had been taken for the untouched sheet, from the beginning of one. No noise, however strong, is a touch:
the strongest filter is to be ``NOISE`` times what it is on average.

A sheet that is bent anew under a faint press may lose it: then the single frame is all there is, as without this.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.model.matched_filters import Filters

Array = npt.NDArray[np.float32]

FAST: Final = 16
"""Frames: 80 ms at 200 frames/s, a twelfth of a bend that takes a second."""

SLOW: Final = 2000
"""Frames, as the untouched sheet's drift is followed (:mod:`eitskin.health.resting`): ten seconds at 200 frames/s."""

FEWEST: Final = 8
"""Untouched frames before changes are judged."""

EVERY: Final = 8
"""Frames from one look at ``recent - base`` to the next."""

NEW: Final = 0.8
HELD: Final = 0.7
"""Of the limit c, which is that of any device at any bend."""

GONE: Final = 4
"""Frames."""

LEFT: Final = 0.1
"""Share of a touch that may stay behind: real sheets keep 3 to 4 % of a press."""

SETTLED: Final = 0.4
"""Mean |w| over a, up to which the sheet has not moved from ``base``."""

NOISE: Final = 2.25
"""Of noise alone one frame in 20,000 has a filter that is above so many times the average of the strongest."""

LEVEL: Final = 1.0 / 256.0
"""Share of a frame in that average."""

MEAN: Final = (2 * FAST - 1) ** -0.5
"""Noise of ``recent`` over that of a frame."""


# Of arrays that are known to be ones, without the wrappers of their methods.
_largest, _smallest, _sum = np.maximum.reduce, np.minimum.reduce, np.add.reduce


class Changes:
    """Judges frames one after the other by what has changed; allocates nothing a frame.

    Args:
        filters: Of the gate.
        width: Of a response.
    """

    __slots__ = (
        "_base", "_change", "_filters", "_found", "_looked", "_missed", "_peak", "_recent", "_sizes", "_step",
        "_whitened", "held", "level", "seen", "strength",
    )  # fmt: skip

    def __init__(self, filters: Filters, width: int) -> None:
        self._base, self._recent, self._change, self._step = (np.zeros(width, dtype=np.float32) for _ in range(4))
        self._whitened, self._found = self._change[: filters.whitened], self._change[filters.whitened :]
        self._sizes = np.zeros(filters.whitened, dtype=np.float32)
        self.begin(filters)

    def begin(self, filters: Filters) -> None:
        """Begin anew, with filters of as many numbers that look for the same touches.

        Args:
            filters: The gate's from now on.
        """
        self._filters = filters
        self.forget()

    def forget(self) -> None:
        """Begin anew: what the untouched sheet reads is not known."""
        self.seen = 0
        """Untouched frames that are remembered."""
        self.level = 0.0
        """What the strongest filter is on average, of untouched frames."""
        self.held = False
        """A touch lies there: nothing is learned."""
        self.strength = 0.0
        """Of the last change that was looked at: its strongest filter."""
        self._peak = 0.0
        self._missed = self._looked = 0

    def step(self, response: Array, touched: bool) -> bool:
        """Return whether a frame shows a touch by what has changed.

        Args:
            response: (width,) p.
            touched: What the gate says of the frame by itself.
        """
        if self.held:
            return self._hold(response, touched)
        ratio = self._compare(response, self._recent)
        found = self.seen >= FEWEST and ratio > NEW * self._filters.limit
        if not (found or touched):
            self._learn(response)
            found = self._looked == EVERY and self._look()
            if not found:
                return False
        elif self.seen < FEWEST:
            return False  # nothing to hold it against
        elif self._moved():
            np.copyto(self._base, self._recent)
        self._compare(response, self._base)
        self.held, self._missed, self._peak = True, 0, self.strength
        return found

    def _hold(self, response: Array, touched: bool) -> bool:
        """Judge a frame while a touch is known."""
        there = self._compare(response, self._base) > HELD * self._filters.limit
        stays = there and self.strength > LEFT * self._peak
        if stays or touched:
            self._missed = 0
            if self.strength > self._peak:
                self._peak = min(self.strength, 2.0 * self._peak)  # one wild frame is no measure
            return stays
        self._missed += 1
        self._mix(self._recent, response, 1.0 / self._missed)
        if self._missed == GONE:
            self.held = False
            if there:
                self.forget()  # what is left of it is the sheet's from now on
        return False

    def _learn(self, response: Array) -> None:
        """Take a frame that was held against ``recent``, and is untouched, into it."""
        self.seen += 1
        if self.seen > 1:
            self.level += (self.strength - self.level) * max(LEVEL, 1.0 / (self.seen - 1))
        self._mix(self._recent, response, max(1.0 / FAST, 1.0 / self.seen))
        if self.seen <= FEWEST:
            np.copyto(self._base, self._recent)
        else:
            self._looked += 1

    def _look(self) -> bool:
        """Hold ``recent`` against ``base``, and return whether that shows a touch; else ``base`` follows."""
        self._looked = 0
        ratio = self._compare(self._recent, self._base, MEAN, ends=True)
        if ratio > self._filters.limit:
            return True
        if -ratio > self._filters.limit:
            self.forget()  # a touch that had been taken for the untouched sheet is gone
        else:
            self._mix(self._base, self._recent, max(EVERY / SLOW, EVERY / self.seen))
        return False

    def _compare(self, now: Array, before: Array, noise: float = 1.0, *, ends: bool = False) -> float:
        """Return strength over size of a change, below 0 where a touch has gone; 0 where it may be noise alone.

        Args:
            now: (width,) p.
            before: (width,) p.
            noise: Of ``now``, over that of a frame.
            ends: Whether the end of a touch is looked for where none begins.
        """
        np.subtract(now, before, out=self._change)
        self.strength = strength = float(_largest(self._found))
        floor = NOISE * self.level * noise
        if strength <= floor and not ends:
            return 0.0
        against = -float(_smallest(self._found)) if self._filters.one_sign else 0.0
        if max(strength, against) <= floor:
            return 0.0
        return (strength if strength >= against else -against) / (self._size() + self._filters.still)

    def _moved(self) -> bool:
        """Return whether the sheet has moved since ``base``: then ``recent`` is nearer to what it reads untouched."""
        np.subtract(self._recent, self._base, out=self._change)
        return self._size() > SETTLED * self._filters.still

    def _size(self) -> float:
        """Return mean |w| of the change."""
        np.abs(self._whitened, out=self._sizes)
        return float(_sum(self._sizes)) / self._filters.whitened

    def _mix(self, mean: Array, value: Array, share: float) -> None:
        np.subtract(value, mean, out=self._step)
        np.multiply(self._step, np.float32(share), out=self._step)
        np.add(mean, self._step, out=mean)
