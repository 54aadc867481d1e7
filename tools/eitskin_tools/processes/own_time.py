"""Time that a process had to itself: without that in which it waited for a core, or was stopped.

From what Linux counts for each thread (``/proc/PID/task/TID/schedstat``: nanoseconds on a core, and in the queue for
one). Where the kernel does not count, all time is the process' own unless it is stopped.
"""

from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

STOPPED: Final = "Tt"
"""States of who was stopped, by a signal or by a debugger."""

RUNNABLE: Final = "R"


class Thread(NamedTuple):
    """A thread at a look."""

    state: str
    ran_ns: int
    queued_ns: int


class OwnTime:
    """Counts it between looks.

    Args:
        pid: Whose.
        now_s: Of the first look, on any clock.
        proc: Where the kernel tells of processes.
    """

    def __init__(self, pid: int, now_s: float, proc: Path = Path("/proc")) -> None:
        self._pid, self._tasks = str(pid), proc / str(pid) / "task"
        self._threads, self._looked_s = self._found(), now_s

    def since_last(self, now_s: float) -> float:
        """Return the process' own seconds since the last look; 0 once it is gone.

        All waiting of the thread that waited most is left out: threads wait for each other, so one that gets no core
        holds up the others.
        """
        before, self._threads = self._threads, self._found()
        elapsed_s, self._looked_s = now_s - self._looked_s, now_s
        main = self._threads.get(self._pid)
        if main is None or main.state in STOPPED:
            return 0.0
        queued_s = [
            _queued_s(before[key], now, elapsed_s) for key, now in self._threads.items() if key in before
        ]  # one that is new was not there to wait
        return max(0.0, elapsed_s - max(queued_s, default=0.0))

    def _found(self) -> dict[str, Thread]:
        found = {}
        with suppress(OSError):
            for task in self._tasks.iterdir():
                with suppress(OSError, ValueError, IndexError):  # it has just ended
                    state = (task / "stat").read_text().rpartition(")")[2].split()[0]
                    found[task.name] = Thread(state, *_counted(task / "schedstat"))
        return found


def _counted(path: Path) -> tuple[int, int]:
    try:
        ran, queued, *_ = path.read_text().split()
    except FileNotFoundError:
        return 0, 0
    return int(ran), int(queued)


def _queued_s(before: Thread, now: Thread, elapsed_s: float) -> float:
    """Return how long a thread was in the queue for a core; the kernel adds that up only once it has got one."""
    counts = now.ran_ns > 0 or now.queued_ns > 0
    if counts and now.state == RUNNABLE and now == before:
        return elapsed_s
    return (now.queued_ns - before.queued_ns) * 1e-9
