"""Attacks by number: honest subscribers up to the promise and beyond it, strangers who connect and say nothing."""

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
from ..zmtp.peer import GREETING, attempt, connected, packed, ready
from .ground import TOUCHED, defended, everywhere, status

PROMISED = 128
"""Subscribers that get every frame."""

STRANGERS = 150


@contextlib.contextmanager
def crowd(stream: Stream, number: int) -> Iterator[dict[str, Any]]:
    """Run a crowd beside the body; afterwards the dictionary says what it got."""
    found: dict[str, Any] = {}
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.attack.subscribers.crowd", stream.frames, str(number), str(stream.runtime.pid)],
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
        found.update(stream.paced(json.loads(out.splitlines()[-1])))
    finally:
        process.kill()
        process.communicate()


def honest_crowds(effort: Effort) -> Outcome:
    """Be many and honest: everybody up to the promised number gets every frame, whoever comes then costs nobody any."""
    outcome = Outcome("subscribers.honest")
    for number in (1, 8, 32, 64, 100, PROMISED) if effort.long else (PROMISED,):
        _honest(effort, outcome, f"{number}", number)
    for number in (8, 64, PROMISED) if effort.long else (PROMISED,):
        _honest(effort, outcome, f"{number} on TCP", number, "--publish", "tcp://127.0.0.1:*")
    return outcome


def _honest(effort: Effort, outcome: Outcome, what: str, number: int, *arguments: str) -> None:
    """Be so many at one place; one process reads for all, and the short form leaves it time on a busy machine."""
    options = {**TOUCHED, "rate_hz": float(effort.count(40, 200))}
    with attacked(*arguments, **options) as stream, crowd(stream, number) as found:
        late = [Late(stream.frames) for _ in range(effort.count(3, 20))] if number == PROMISED else []
        if late and not arguments:  # on TCP libzmq lets somebody in, who may have a frame before he is ended
            outcome.note(*_told(stream.frames))
        first = status(stream)["frames"]
        while status(stream)["frames"] < first + effort.count(100, 4000):
            time.sleep(0.05)
        for newcomer in late:
            if arguments:
                outcome.note(newcomer.ended(), f"{what}: who was beyond them was not ended")
            else:
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
    outcome.note_pace(found["pace"], what)


class Late:
    """Who comes when there are enough: greets and subscribes without waiting for an answer."""

    def __init__(self, endpoint: str) -> None:
        self._stream = attempt(endpoint)  # None where so many wait that nobody else may
        if self._stream is not None:
            self._stream.sendall(GREETING + ready("SUB") + packed(b"\x01"))

    def served(self) -> int:
        """Leave, and return how many bytes came: whoever is not let in is not even greeted."""
        if self._stream is None:
            return 0
        with self._stream:
            try:
                return len(self._stream.recv(1 << 20))
            except OSError:  # nothing came, or it was ended
                return 0

    def ended(self) -> bool:
        """Wait for the other side to end it, and return whether it did."""
        if self._stream is None:
            return True
        with self._stream:
            self._stream.settimeout(PATIENCE_S)
            try:
                while self._stream.recv(1 << 20):
                    pass
            except TimeoutError:
                return False
            except OSError:
                pass
            return True


def _told(endpoint: str) -> tuple[bool, str]:
    """Return whether a subscriber beyond the promise hears why it gets nothing, and what it heard."""
    try:
        with eitskin.subscribe(endpoint, timeout_s=2.0) as frames:
            return False, f"frame {next(frames).number} came to who was too many"
    except eitskin.NoFrame as error:
        return "as many subscribers as it may" in str(error), f"who is too many hears: {error}"


def silent_crowds(effort: Effort) -> Outcome:
    """Hold connections and say nothing, or half a greeting, on TCP with and without keys, and on ipc."""
    outcome = Outcome("subscribers.silent")
    with everywhere() as places:
        for what, arguments, keys in places:
            with defended(outcome, what, keys, arguments) as stream:
                held = []
                for turn in range(effort.count(1, 5)):
                    for index in range(STRANGERS):
                        with contextlib.suppress(OSError):
                            held.append(connected(stream.frames, 0.05))
                            held[-1].send((b"", GREETING[: 1 + 9 * turn], GREETING)[index % 3])
                    first = status(stream)["frames"]
                    enough = first + effort.count(600, 1000)  # longer than a handshake may take
                    while status(stream)["frames"] < enough:
                        time.sleep(0.05)
                for one in held:
                    one.close()
    return outcome
