"""How long a process took to end, by the clock, and without the time in which it could have gone on but got no core.

The kernel counts for each thread how long it waited for a core (``/proc/PID/task/TID/schedstat``), and adds a wait when
it is over. It is looked at every few milliseconds: a wait of that length has ended just now; and threads that are seen
waiting wait, for one that ends right behind its wait is gone before that can be read. The union of all waits is
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

STILL_S = 0.02
"""The kernel counts what a thread has run at least so often while it runs."""

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


class Waits:
    """The spans in which some thread of a process, or the one that looks, could have gone on and got no core.

    The kernel counts a wait when it is over, so who ends right after one is gone before that can be read. Threads that
    wait are therefore seen while they do: ready to run at every look for ``STILL_S``, and not a nanosecond run.

    Args:
        process: It.
        start_s: Nothing before this counts; as all times on one clock.
        proc: Where the kernel tells.
    """

    def __init__(self, process: int, start_s: float, proc: Path = Path("/proc")) -> None:
        self.spans: list[tuple[float, float]] = []
        self._tasks, self._own = proc / str(process) / "task", proc / "thread-self"
        self._start_s = start_s
        self._before: dict[str, tuple[int, int, bool]] = {}
        self._still_since_s: dict[str, float] = {}
        """Since when threads are ready to run and have not run."""
        self.look(start_s)

    def look(self, now_s: float) -> None:
        """Look again."""
        found: dict[str, tuple[int, int, bool]] = {}
        with suppress(OSError):
            for thread in os.listdir(self._tasks):
                with suppress(OSError):
                    found[thread] = _told(self._tasks / thread)
        with suppress(OSError):
            found["watcher"] = (*_told(self._own)[:2], False)
        for thread, (ran_ns, waited_ns, ready) in found.items():
            ran_before_ns, waited_before_ns, ready_before = self._before.get(thread, (ran_ns, waited_ns, False))
            if waited_ns > waited_before_ns:
                self.spans.append((max(self._start_s, now_s - (waited_ns - waited_before_ns) * 1e-9), now_s))
            if not (ready and ready_before and ran_ns == ran_before_ns):
                self._still_since_s[thread] = now_s
            elif now_s - self._still_since_s[thread] >= STILL_S:
                self.spans.append((self._still_since_s[thread], now_s))
        self._before = found


def _told(task: Path) -> tuple[int, int, bool]:
    """Return for how many ns a thread ran and waited for a core, and whether it is ready to run."""
    ran_ns, waited_ns = map(int, (task / "schedstat").read_text().split()[:2])
    return ran_ns, waited_ns, (task / "stat").read_text().rpartition(")")[2].split()[0] == "R"


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
        start_s = time.monotonic()
        waits = Waits(process, start_s)
        os.kill(process, number)
        while True:
            ended = poll.poll(LOOK_MS)
            now_s = time.monotonic()
            waits.look(now_s)
            took = ExitTime(now_s - start_s, union_s(waits.spans))
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
