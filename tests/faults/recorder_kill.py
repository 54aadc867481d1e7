"""Kills the recorder, ``kill -9``, and reads what it left.

Beside it we subscribe ourselves, so that we know which frame had come when it died. Every file must be readable, and
all files of a recorder together must hold every frame from their first to their last.
"""

import subprocess
import sys
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

START_S: Final = 120.0
"""How long the recorder may take to begin."""


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


def kill_one(endpoint: str, path: Path, after_s: float, witness: Witness) -> Left:
    """Start a recorder of a runtime into a new file, kill it so long after its first bytes, and return what it left.

    Raises:
        SkinError: The recorder does not begin.
    """
    command = [sys.executable, "-m", "eitskin_tools.cli", "record", endpoint, "--out", str(path), "--quiet"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        _until(lambda: path.exists() and path.stat().st_size > 0, process, "did not begin")
        time.sleep(after_s)
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
