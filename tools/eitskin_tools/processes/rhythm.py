"""Predicts when frames come, so that work that can wait is done between two of them.

Where cores are few, a thread that wakes just when a frame comes keeps a core from the frame loop, or from a robot that
waits for the frame. The stamps of frames that were taken say when the next ones will be there. ::

    frames     |computed, sent|                    |computed, sent|
    rest       ...................^ a share of the time between two frames after one of them

The stamps of another machine are useless for this; then work waits a little longer than necessary.
"""

import time
from typing import Final

PHASE: Final = 0.4
"""Of the time between two frames, after which the first is through: 2 ms at 200 frames/s."""

MIN_PERIOD_NS: Final = 2_500_000
"""Between two frames; where they come faster there is no time in between."""

MAX_PERIOD_NS: Final = 100_000_000
"""The longest wait for a moment between two frames."""

SMOOTHING: Final = 0.1
"""Weight of the newest two frames in the time between two."""


class Rhythm:
    """Learns from frames when the next ones come; for one thread, others may ask."""

    __slots__ = ("_apart_ns", "_at_ns", "_number")

    def __init__(self) -> None:
        self._number = self._at_ns = 0
        self._apart_ns = 0.0

    def add(self, number: int, read_ns: int) -> None:
        """Take note of a frame.

        Args:
            number: Counts frames.
            read_ns: When its last byte was in hand, on ``perf_counter_ns``.
        """
        count, span_ns = number - self._number, read_ns - self._at_ns
        if count > 0 and 0 < span_ns <= count * MAX_PERIOD_NS:
            apart_ns = span_ns / count
            self._apart_ns += (apart_ns - self._apart_ns) * (SMOOTHING if self._apart_ns else 1.0)
        else:
            self._apart_ns = 0.0
        self._number, self._at_ns = number, read_ns

    def pause_s(self, least_s: float) -> float:
        """Return how long to rest from now on: at least so long, and then up to a moment when a frame is through."""
        apart_ns = self._apart_ns
        if apart_ns < MIN_PERIOD_NS:
            return least_s
        least_ns = least_s * 1e9
        since_ns = time.perf_counter_ns() + least_ns - self._at_ns - PHASE * apart_ns
        return (least_ns + -since_ns % apart_ns) * 1e-9
