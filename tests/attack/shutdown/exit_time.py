"""How long a process took to end, by the clock, and without the time in which it could have gone on but got no core.

The kernel counts for each thread how long it waited for a core (``/proc/PID/task/TID/schedstat``), and adds a wait when
it is over. It is looked at every few milliseconds: a wait of that length has ended just now. The union of all waits is
taken off: on a quiet machine that is nothing, and waits of several threads at once count once. The watcher's own waits,
which only make it notice the end late, are among them. Its waits for Python's lock are not, which another thread may
keep while it gets no core: where several threads end processes, each has a :class:`Watch`.
"""

import json
import os
import select
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[3]

LOOK_MS = 5

MOST_S = 1.0
"""How long an end may take, of its own."""

SURELY_S = 20.0
"""After which it is no longer waited for."""


@dataclass(frozen=True)
class ExitTime:
    """Of one process."""

    raw_s: float
    """By the clock."""
    waited_s: float
    """Of that, without a core."""

    @property
    def own_s(self) -> float:
        """What it took by itself."""
        return self.raw_s - self.waited_s


def waits_ns(process: int) -> dict[str, int]:
    """Return {thread: how long it has waited for a core}, of a process and of the thread that asks."""
    found = {}
    with suppress(OSError):
        for thread in os.listdir(f"/proc/{process}/task"):
            with suppress(OSError):
                found[thread] = int(Path(f"/proc/{process}/task/{thread}/schedstat").read_text().split()[1])
    found["watcher"] = int(Path("/proc/thread-self/schedstat").read_text().split()[1])
    return found


def union_s(spans: list[tuple[float, float]]) -> float:
    """Return the length of the union of some spans of time."""
    total_s, last_s = 0.0, float("-inf")
    for start_s, stop_s in sorted(spans):
        total_s += max(0.0, stop_s - max(start_s, last_s))
        last_s = max(last_s, stop_s)
    return total_s


def end(process: int, number: int, most_s: float = SURELY_S) -> ExitTime | None:
    """Send a signal and return how long the process took to end; None if it did not within so much of its own time."""
    descriptor = os.pidfd_open(process)
    try:
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        before = waits_ns(process)
        waited: list[tuple[float, float]] = []
        start_s = time.monotonic()
        os.kill(process, number)
        while True:
            ended = poll.poll(LOOK_MS)
            now_s, waits = time.monotonic(), waits_ns(process)
            for thread, total_ns in waits.items():
                if (wait_s := (total_ns - before.get(thread, total_ns)) * 1e-9) > 0:
                    waited.append((max(start_s, now_s - wait_s), now_s))
            before = waits
            took = ExitTime(now_s - start_s, union_s(waited))
            if ended:
                return took
            if took.own_s > most_s:
                return None
    finally:
        os.close(descriptor)


class Watch:
    """A process of one thread that calls :func:`end`; release it with ``close``."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
        )

    def end(self, process: int, number: int) -> ExitTime | None:
        """Send a signal and return how long the process took to end, as the function does."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps([process, number]), file=self._process.stdin, flush=True)
        found = json.loads(self._process.stdout.readline())
        return None if found is None else ExitTime(*found)

    def close(self) -> None:
        """End the watcher."""
        self._process.communicate()


def main() -> None:
    """Answer each line ``[process, signal]`` with ``[raw_s, waited_s]``, or null if it did not end."""
    for line in sys.stdin:
        took = end(*json.loads(line))
        print(json.dumps(None if took is None else [took.raw_s, took.waited_s]), flush=True)


if __name__ == "__main__":
    main()
