"""Damaged files of every kind: each must be read, or refused with a line, within bounds of memory and time."""

import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

from tests.attack.outcome import Effort, Outcome

from .kinds import KINDS

ROOT: Final = Path(__file__).parents[3]

START_S: Final = 600.0
MOST_AT_ONCE: Final = 4
"""Kinds that are tried at a time; one may take a gigabyte."""

WALL_S: Final = 300.0
"""By the clock, for one try: one that waits for something that never comes takes no CPU."""


class Worker:
    """A process that tries files of one kind; started anew where a try ended it."""

    def __init__(self, kind: str, folder: Path) -> None:
        self._kind, self._folder, self._number = kind, folder, 0
        self._process: subprocess.Popen[bytes] | None = None

    def attempt(self, seed: int) -> dict[str, object]:
        """Return what came of one try."""
        if self._process is None:
            self._start()
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(f"{seed}\n".encode())
        self._process.stdin.flush()
        line = self._line(WALL_S)
        if line:
            found: dict[str, object] = json.loads(line)
            return found
        running = self._process.poll() is None
        self.end()
        how = f"hung for {WALL_S:g} s" if running else "ended the process, by a bound or a crash"
        return {"how": how, "what": "?", "seconds": 0.0}

    def end(self) -> None:
        """End the process, if it runs."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _start(self) -> None:
        self._number += 1
        folder = self._folder / str(self._number)
        folder.mkdir()
        with (self._folder / "stderr").open("ab") as stderr:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.attack.files.worker", str(folder), self._kind],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stderr,
                cwd=ROOT,
                env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            )
        if self._line(START_S) != b"ready\n":
            self.end()
            said = (self._folder / "stderr").read_text(errors="replace")[-600:]
            raise RuntimeError(f"the sample of a {self._kind} cannot be read: {said}")

    def _line(self, timeout_s: float) -> bytes:
        """Return the next line, or nothing if none comes in time or the process ended."""
        assert self._process is not None
        assert self._process.stdout is not None
        until, found = time.monotonic() + timeout_s, b""
        file = self._process.stdout.fileno()
        while not found.endswith(b"\n"):
            ready, _, _ = select.select([file], [], [], max(0.0, until - time.monotonic()))
            piece = os.read(file, 65536) if ready else b""
            if not piece:
                return b""
            found += piece
        return found


def files(effort: Effort) -> Outcome:
    """Try damaged files of each kind; several kinds at a time where there are cores."""
    outcome = Outcome("files.readers")
    ways: Counter[str] = Counter()
    seconds: dict[str, float] = {}
    with tempfile.TemporaryDirectory(prefix="a") as folder, ThreadPoolExecutor(_at_once()) as pool:
        tries = {kind: pool.submit(_tried, kind, Path(folder), effort) for kind in KINDS}
        for kind, done in tries.items():
            seconds[kind], found_of = done.result()
            for seed, found in found_of.items():
                held = found["how"] in ("read", "refused")
                ways[f"{kind}: {found['how'] if held else str(found['how']).partition(':')[0]}"] += 1
                outcome.note(held, f"{kind}, seed {seed}, {found['what']}: {found['how']}")
    outcome.figures = {"seconds_by_kind": seconds, "by_kind": dict(sorted(ways.items()))}
    return outcome


def _at_once() -> int:
    """Return how many kinds are tried at a time; each try is held to its own CPU time, whatever goes on beside."""
    return max(1, min(MOST_AT_ONCE, len(os.sched_getaffinity(0))))


def _tried(kind: str, folder: Path, effort: Effort) -> tuple[float, dict[int, dict[str, object]]]:
    """Return how long a kind took, and what came of each seed."""
    place = folder / kind
    place.mkdir()
    worker = Worker(kind, place)
    began, first = time.monotonic(), effort.seed * 1_000_000
    try:
        found = {seed: worker.attempt(seed) for seed in range(first, first + effort.count(12, KINDS[kind].long))}
    finally:
        worker.end()
    return round(time.monotonic() - began, 1), found
