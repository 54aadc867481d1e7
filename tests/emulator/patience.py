"""Asking an emulated board: real firmware, whose answers come when the machine below lets it run.

A board that is starved of processor time is slow, not gone. So a request is asked again many times before the board
counts as silent; every request may be asked twice without harm, and a late answer to an earlier try is as good.
"""

import time
from collections.abc import Callable
from typing import Final

from eitskin.acquisition.transport import Transport, WrappedTransport
from eitskin.errors import PortLost
from eitskin_tools.flash.exchange import Exchange

ANSWER_S: Final = 2.0
"""How long one try waits for its answer; a board alone on a machine answers within a millisecond."""

TRIES: Final = 30
"""A minute in all."""

LOOK_S: Final = 0.02
"""How often a read looks whether the board was stopped; the file that says so cannot be waited on."""


def patient(line: Transport) -> Exchange:
    """Return an exchange over a line to an emulated board that gives up only after a minute of silence."""
    return Exchange(line, timeout_s=ANSWER_S, attempts=TRIES)


class UntilStopped(WrappedTransport):
    """A line that fails as soon as its board has stopped, so that no reader waits for an answer that cannot come.

    Args:
        line: To the board.
        stopped: Whether the board has stopped.
    """

    __slots__ = ("_stopped",)

    def __init__(self, line: Transport, stopped: Callable[[], bool]) -> None:
        super().__init__(line)
        self._stopped = stopped

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return what came, empty after the timeout.

        Raises:
            PortLost: The board has stopped.
        """
        end_s = None if timeout_s is None else time.perf_counter() + timeout_s
        while True:
            if self._stopped():
                raise PortLost(f"{self.name} is the line of a board that has stopped")
            left_s = LOOK_S if end_s is None else end_s - time.perf_counter()
            data = self._line.read(max(0.0, min(LOOK_S, left_s)))
            if data or left_s <= 0.0:
                return data
