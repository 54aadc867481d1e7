"""Kills the recorder, ``kill -9``, at random moments, and reads what it left: ``python -m ... ENDPOINT --kills 50``.

Beside it we subscribe ourselves, so that we know which frame had come when it died. Every file must be readable, hold
every frame from its first to its last, and end at most a second before that one.
"""

import argparse
import json
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from eitskin.messaging.streams.measured import WireFrame
from eitskin.messaging.streams.subscription import subscribe_streams
from eitskin_proto.errors import SkinError
from eitskin_tools.recording.script import Script

LONGEST_S: Final = 3.0
"""Between the first bytes of a file and the kill, at most."""

START_S: Final = 120.0
"""How long the recorder may take to begin."""

ALLOWED_S: Final = 1.0
"""What may be missing at the end."""


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
    missing_s: float
    """From the last frame of the file to the last one that had come."""
    gaps: int
    """Frames that are missing in the middle."""


def kill_one(endpoint: str, path: Path, after_s: float, witness: Witness) -> Left:
    """Start a recorder, kill it so long after its first bytes, and return what it left.

    Args:
        endpoint: Of a runtime.
        path: Of a new file.
        after_s: When to kill.
        witness: Follows the same runtime.

    Raises:
        SkinError: The recorder does not begin, or its file cannot be read.
    """
    command = [sys.executable, "-m", "eitskin_tools.cli", "record", endpoint, "--out", str(path), "--quiet"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        end_s = time.monotonic() + START_S
        while not path.exists() or not path.stat().st_size:
            if process.poll() is not None or time.monotonic() > end_s:
                process.kill()
                raise SkinError(f"the recorder did not begin: {process.communicate()[1].strip()[:300]}")
            time.sleep(0.005)
        time.sleep(after_s)
        newest_ns = witness.read_ns
        process.kill()
        process.wait()
    try:
        script = Script(path)
    except SkinError as error:
        if "no frame" not in str(error):
            raise
        return Left(0, after_s, 0)  # killed before its first chunk
    numbers = [step.frame.n for step in script.steps()]
    gaps = numbers[-1] - numbers[0] + 1 - len(numbers)
    last_ns = script.last_ns - script.recording.wall_minus_host_ns
    return Left(len(numbers), max(newest_ns - last_ns, 0) * 1e-9, gaps)


def main(argv: Sequence[str] | None = None) -> int:
    """Kill recorders, say what they left, and return 0 if nothing is missing that should be there."""
    parser = argparse.ArgumentParser(description="Kill the recorder at random moments and read what it left.")
    parser.add_argument("endpoint", help="where a runtime publishes")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    rng, left = random.Random(arguments.seed), []
    witness = Witness(arguments.endpoint)
    with tempfile.TemporaryDirectory(prefix="eitskin-kill-") as folder:
        for number in range(arguments.kills):
            path = Path(folder) / f"{number}.mcap"
            left.append(kill_one(arguments.endpoint, path, rng.uniform(0.0, LONGEST_S), witness))
            print(f"{number + 1}: {left[-1]}", file=sys.stderr)
    witness.close()
    missing = [one.missing_s for one in left]
    bad = sum(one.missing_s > ALLOWED_S or one.gaps > 0 for one in left)
    found = {"kills": len(left), "readable": len(left), "most_missing_s": round(max(missing), 3),
             "mean_missing_s": round(sum(missing) / len(missing), 3), "bad": bad}  # fmt: skip
    print(json.dumps(found))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
