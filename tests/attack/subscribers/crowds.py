"""Attacks by number: honest subscribers up to the promise and beyond it."""

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import eitskin

from ..outcome import Effort, Outcome
from ..stream import PATIENCE_S, ROOT, Stream, attacked
from ..zmtp.peer import GREETING, attempt, packed, ready
from .ground import TOUCHED, status

PROMISED = 128
"""Subscribers that get every frame."""


@contextlib.contextmanager
def crowd(stream: Stream, number: int) -> Iterator[dict[str, Any]]:
    """Run a crowd beside the body; afterwards the dictionary says what it got."""
    found: dict[str, Any] = {}
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.attack.subscribers.crowd", stream.frames, str(number)],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    assert process.stdout is not None
    try:
        if process.stdout.readline().strip() != "subscribed":
            raise RuntimeError(f"{number} subscribers at {stream.frames} did not all get a frame")
        yield found
        process.terminate()
        out, _ = process.communicate(timeout=PATIENCE_S)
        found.update(json.loads(out.splitlines()[-1]))
    finally:
        process.kill()
        process.communicate()


def honest_crowds(effort: Effort) -> Outcome:
    """Be many and honest: everybody up to the promised number gets every frame, and later ones cost nobody any."""
    outcome = Outcome("subscribers.honest")
    for number in (1, 8, 32, 64, 100, PROMISED) if effort.long else (PROMISED,):
        _honest(effort, outcome, f"{number}", number)
    return outcome


def _honest(effort: Effort, outcome: Outcome, what: str, number: int) -> None:
    """Be so many; one process reads for all, and the short form leaves it time on a busy machine."""
    options = {**TOUCHED, "rate_hz": float(effort.count(40, 200))}
    with attacked(**options) as stream, crowd(stream, number) as found:
        late = [LaterChanges(stream.frames) for _ in range(effort.count(3, 20))] if number == PROMISED else []
        if late:
            outcome.note(*_told(stream.frames))
        first = status(stream)["frames"]
        while status(stream)["frames"] < first + effort.count(100, 4000):
            time.sleep(0.05)
        for newcomer in late:
            served = newcomer.served()
            outcome.note(not served, f"{served} bytes came to who was beyond {number} subscribers")
    outcome.frames_lost += found["lost"]
    for name, value in (
        ("frames_per_s_of_each", [round(found[name] / found["span_s"], 1) for name in ("fewest", "most")]),
        ("lost_of_all", found["lost"]),
        ("longest_silence_s", found["longest_silence_s"]),
    ):
        outcome.figures.setdefault(name, {})[what] = value
    whole = found["lost"] == 0 and found["ended"] == 0 and found["behind"] < 100
    outcome.note(whole, f"{what}: {found}")


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
        return "as many subscribers as it may" in str(error), f"who is too many hears: {error}"
