"""Keeps a latency budget: switches to a faster solver when the machine is too slow, and back later.

::

    level 0      1            2             3 (last engine)   4
    vd2t    ->   vd2t-int8 -> vd2t-small -> tikhonov      ->  tikhonov, and of several waiting frames only the newest

A bundle without a smaller network has one level less. A stream begins at the first level whose engine alone uses less
than half of the budget. An overrun goes down one level at once. It goes up one level after a period of frames that use
less than half of the budget. The period doubles each time that going up led straight to another overrun, so that the
level does not oscillate.
"""

from typing import Final

HOLD_FRAMES: Final = 100
"""Easy frames before the first attempt to go up: half a second at 200 frames/s."""

LONGEST_HOLD: Final = 6400
"""Half a minute."""

MOST_MS: Final = 1e6
"""A budget of more is none: a quarter of an hour."""

EASY_SHARE: Final = 0.5
"""A frame that took less than this part of the budget is easy."""


def in_ns(budget_ms: float | None) -> int | None:
    """Return a budget of milliseconds in nanoseconds; None is none.

    Raises:
        ValueError: It is not above 0, or more than ``MOST_MS``.
    """
    if budget_ms is None:
        return None
    if not 0 < budget_ms <= MOST_MS:
        raise ValueError(f"budget_ms is {budget_ms:g}, expected more than 0 and at most {MOST_MS:.0f}")
    return round(budget_ms * 1e6)


class LatencyBudget:
    """Follows the latency of frames against a budget.

    Args:
        budget_ns: From read to publish; None for no budget, which stays on level 0.
        engines: How many there are.
        level: The first one.
    """

    __slots__ = ("_easy", "_hold", "_last", "_level", "_risen", "budget_ns", "drops_stale", "engine", "overruns")

    def __init__(self, budget_ns: int | None, engines: int, level: int = 0) -> None:
        if budget_ns is not None and budget_ns <= 0:
            raise ValueError(f"a budget of {budget_ns} ns is not positive")
        self.budget_ns = budget_ns
        self.overruns = 0
        """Frames over budget so far."""
        self._last = engines  # one beyond the last engine: drop stale input
        self.level = level
        self._easy = 0
        self._hold = HOLD_FRAMES
        self._risen = False

    @property
    def level(self) -> int:
        """0 for the most accurate engine; with each overrun one more."""
        return self._level

    @level.setter
    def level(self, level: int) -> None:
        self._level = level
        self.engine = min(level, self._last - 1)
        """Which engine computes the next frame."""
        self.drops_stale = level == self._last
        """Only the newest of several waiting frames is computed."""

    def judge(self, elapsed_ns: int, *, inferred: bool) -> bool:
        """Return whether a frame overran the budget, and move for the next one.

        Args:
            elapsed_ns: From read to publish.
            inferred: An engine ran; a frame without inference says nothing about the room for a slower engine.
        """
        budget_ns = self.budget_ns
        if budget_ns is None:
            return False
        if elapsed_ns > budget_ns:
            self.overruns += 1
            if self._risen:
                self._hold = min(2 * self._hold, LONGEST_HOLD)
            self._risen = False
            self._easy = 0
            self.level = min(self.level + 1, self._last)
        elif elapsed_ns < EASY_SHARE * budget_ns and (inferred or self.drops_stale):
            self._easy += 1
            if self._easy >= self._hold:
                self._rise()
        return elapsed_ns > budget_ns

    def _rise(self) -> None:
        self._easy = 0
        if self.level == 0:
            self._hold, self._risen = HOLD_FRAMES, False  # the top was held: the next fall is a new matter
        else:
            self.level -= 1
            self._risen = True
