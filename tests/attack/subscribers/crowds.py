"""Attacks by number: honest subscribers up to the promise and beyond it."""

import time

import eitskin

from ..outcome import Effort, Outcome
from ..stream import attacked
from ..zmtp.peer import GREETING, attempt, packed, ready
from .ground import TOUCHED, status

PROMISED = 128
"""Subscribers that get every frame."""


def honest_crowds(effort: Effort) -> Outcome:
    """Be many and honest: everybody up to the promised number gets every frame, and later ones cost nobody any."""
    outcome = Outcome("subscribers.honest")
    for number in (1, 8, 32, 64, 100, PROMISED) if effort.long else (PROMISED,):
        _honest(effort, outcome, number)
    return outcome


def _honest(effort: Effort, outcome: Outcome, number: int) -> None:
    """Be so many; one process reads for all, and the short form leaves it time on a busy machine."""
    with attacked(**{**TOUCHED, "rate_hz": float(effort.count(40, 200))}) as stream:
        crowd = stream.join(number=number)
        late = [LaterChanges(stream.frames) for _ in range(effort.count(3, 20))] if number == PROMISED else []
        if late:
            outcome.note(*_told(stream.frames))
        first = status(stream)["frames"]
        while status(stream)["frames"] < first + effort.count(100, 4000):
            time.sleep(0.05)
        for newcomer in late:
            served = newcomer.served()
            outcome.note(not served, f"{served} bytes came to who was beyond {number} subscribers")
        found = crowd.leave()
    outcome.frames_lost += found["lost"]
    outcome.figures[str(number)] = found
    outcome.note(found["lost"] == 0 and found["behind"] < 100, f"{number}: {found}")


class LaterChanges:
    """Who comes when there are enough: greets and subscribes without waiting for an answer."""

    def __init__(self, endpoint: str) -> None:
        self._stream = attempt(endpoint)  # None where so many wait that nobody else may
        if self._stream is not None:
            self._stream.sendall(GREETING + ready("SUB") + packed(b"\x01"))

    def served(self) -> int:
        """Leave, and return how many bytes came: a refused client is not even greeted."""
        if self._stream is None:
            return 0
        with self._stream:
            try:
                return len(self._stream.recv(1 << 20))
            except OSError:  # nothing came, or it was ended
                return 0


def _told(endpoint: str) -> tuple[bool, str]:
    """Return whether a subscriber beyond the promise hears why it gets nothing, and what it heard."""
    try:
        with eitskin.subscribe(endpoint, timeout_s=2.0) as frames:
            return False, f"frame {next(frames).number} came to who was too many"
    except eitskin.NoFrame as error:
        return "no room for another subscriber" in str(error), f"a subscriber too many is told: {error}"
