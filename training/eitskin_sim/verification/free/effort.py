"""The time that one frame may take: who works on it asks before each step."""

import time
from collections.abc import Callable
from typing import Final

SEARCHED: Final = 0.85
"""Share of the budget after which nothing new is tried: the rest confirms what was found."""


class Effort:
    """What a frame may still take, and what it took.

    Making a model of the sheet counts apart: it serves all frames of a shape.

    Args:
        budget_s: For the frame.
        clock: What it is counted by, s.

    Raises:
        ValueError: There is no time.
    """

    def __init__(self, budget_s: float, clock: Callable[[], float] = time.perf_counter) -> None:
        if not budget_s > 0.0:
            raise ValueError(f"a budget of {budget_s:g} s: it must be above 0")
        self._budget_s, self._clock, self._begin = budget_s, clock, clock()
        self.setup_s = 0.0
        """Spent on models of the sheet."""
        self.fits = 0
        """How often touches were fitted."""

    @property
    def seconds(self) -> float:
        """Return what the frame took so far, models apart."""
        return self._clock() - self._begin - self.setup_s

    def searched(self) -> bool:
        """Return whether nothing new is to be tried."""
        return self.seconds >= SEARCHED * self._budget_s

    def over(self) -> bool:
        """Return whether the budget is spent."""
        return self.seconds >= self._budget_s

    def over_with_models(self) -> bool:
        """Return whether it is, models counted."""
        return self.seconds + self.setup_s >= self._budget_s


def never() -> bool:
    """Return False: there is all the time in the world."""
    return False
