"""Kills the recorder, ``kill -9``, at random moments, and reads what it left: ``python -m ... ENDPOINT --kills 50``.

Beside it we subscribe ourselves, so that we know which frame had come when it died. Every file must be readable; all
files of a recorder together must hold every frame from their first to their last, and end at most a second before that
one. With --rotate-mb or --rotate-minutes the recorder goes on in new files meanwhile. Each other kill then waits for
the next file and comes within 30 ms of it.
"""

import argparse
import json
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from eitskin.messaging.streams.measured import WireFrame
from eitskin.messaging.streams.subscription import subscribe_streams
from eitskin_proto.errors import SkinError
from eitskin_tools.recording.script import Script
from eitskin_tools.recording.writer import others

LONGEST_S: Final = 3.0
"""Between the first bytes of a file and the kill, at most."""

START_S: Final = 120.0
"""How long the recorder may take to begin."""

ALLOWED_S: Final = 1.0
"""What may be missing at the end."""

ABOUT_S: Final = 0.03
"""So long behind a new file a kill comes, at most, that is to fall on it."""


class Witness:
    """Follows the stream, and knows its newest frame."""

    def __init__(self, endpoint: str) -> None:
        self._streams = subscribe_streams(endpoint, clouds=False, state=False, conditions=False)
        self.read_ns = 0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="witness", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        for found in self._streams:
            if isinstance(found, WireFrame):
                self.read_ns = found.read_ns
            if self._closing.is_set():
                self._streams.close()
                return

    def close(self) -> None:
        """End it with the next frame."""
        self._closing.set()
        self._thread.join(10.0)


@dataclass(frozen=True, slots=True)
class Left:
    """What one recorder left."""

    frames: int
    """In all of its files."""
    missing_s: float
    """From the last frame of the files to the last one that had come."""
    gaps: int
    """Frames that are missing in the middle."""
    files: int = 1
    unreadable: int = 0
    """Files of which nothing can be said, not even whose they are."""
    between: bool = False
    """The last file has no frame, or is whole: it died while one was ended or begun."""


def kill_one(
    endpoint: str,
    path: Path,
    after_s: float,
    witness: Witness,
    options: Sequence[str] = (),
    *,
    at_next_file: bool = False,
) -> Left:
    """Start a recorder, kill it so long after its first bytes, and return what it left.

    Args:
        endpoint: Of a runtime.
        path: Of a new file.
        after_s: When to kill.
        witness: Follows the same runtime.
        options: Of the recorder.
        at_next_file: Wait for the next file then, and kill within ``ABOUT_S`` of it.

    Raises:
        SkinError: The recorder does not begin, or makes no further file.
    """
    command = [sys.executable, "-m", "eitskin_tools.cli", "record", endpoint, "--out", str(path), "--quiet", *options]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        _until(lambda: path.exists() and path.stat().st_size > 0, process, "did not begin")
        time.sleep(after_s)
        if at_next_file:
            before = len(others(path))
            _until(lambda: len(others(path)) > before, process, "made no further file")
            time.sleep(after_s % ABOUT_S)
        newest_ns = witness.read_ns
        process.kill()
        process.wait()
    return left_in([path, *others(path)], newest_ns, after_s)


def _until(true: Callable[[], bool], process: subprocess.Popen[str], failed: str) -> None:
    """Wait for what the recorder does."""
    end_s = time.monotonic() + START_S
    while not true():
        if process.poll() is not None or time.monotonic() > end_s:
            process.kill()
            raise SkinError(f"the recorder {failed}: {process.communicate()[1].strip()[:300]}")
        time.sleep(0.001)


def left_in(paths: Sequence[Path], newest_ns: int, after_s: float = 0.0) -> Left:
    """Return what is in the files of one recorder.

    Args:
        paths: Of the files, in order.
        newest_ns: When the last frame had come, on the host's clock.
        after_s: How long it ran: all of that is missing where no file has a frame.
    """
    numbers, last_ns, unreadable, between = list[int](), 0, 0, False
    for path in paths:
        between = True
        try:
            script = Script(path)
        except SkinError as error:
            unreadable += "no frame" not in str(error)  # killed before its first chunk
            continue
        between = not script.recording.cut
        numbers += [step.frame.n for step in script.steps()]
        last_ns = script.last_ns - script.recording.wall_minus_host_ns
    if not numbers:
        return Left(0, after_s, 0, len(paths), unreadable, between)
    gaps = numbers[-1] - numbers[0] + 1 - len(numbers)
    return Left(len(numbers), max(newest_ns - last_ns, 0) * 1e-9, gaps, len(paths), unreadable, between)


def main(argv: Sequence[str] | None = None) -> int:
    """Kill recorders, say what they left, and return 0 if nothing is missing that should be there."""
    parser = argparse.ArgumentParser(description="Kill the recorder at random moments and read what it left.")
    parser.add_argument("endpoint", help="where a runtime publishes")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rotate-mb", metavar="MB", help="of the recorder; each other kill falls on a new file")
    parser.add_argument("--rotate-minutes", metavar="M", help="the same")
    arguments = parser.parse_args(argv)
    named = {"--rotate-mb": arguments.rotate_mb, "--rotate-minutes": arguments.rotate_minutes}
    options = [word for name, value in named.items() if value is not None for word in (name, value)]
    rng, left = random.Random(arguments.seed), []
    witness = Witness(arguments.endpoint)
    with tempfile.TemporaryDirectory(prefix="eitskin-kill-") as folder:
        for number in range(arguments.kills):
            path = Path(folder) / f"{number}.mcap"
            on_new = bool(options) and number % 2 == 1
            left.append(
                kill_one(arguments.endpoint, path, rng.uniform(0.0, LONGEST_S), witness, options, at_next_file=on_new)
            )
            print(f"{number + 1}: {left[-1]}", file=sys.stderr)
    witness.close()
    missing = [one.missing_s for one in left]
    bad = sum(one.missing_s > ALLOWED_S or one.gaps > 0 or one.unreadable > 0 for one in left)
    found = {"kills": len(left), "files": sum(one.files for one in left),
             "unreadable": sum(one.unreadable for one in left), "between_files": sum(one.between for one in left),
             "most_missing_s": round(max(missing), 3), "mean_missing_s": round(sum(missing) / len(missing), 3),
             "bad": bad}  # fmt: skip
    print(json.dumps(found))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
