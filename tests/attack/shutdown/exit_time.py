"""How long a process took to end, by the clock, and without the time in which it could have gone on but got no core.

The kernel counts for each thread how long it waited for a core (``/proc/PID/task/TID/schedstat``). Every few
milliseconds the longest such wait among the threads is taken off, and never more than the interval: on a quiet machine
nothing is, and waits of several threads at once count once. The watcher's own wait, which only makes it notice the end
late, counts as one of them.
"""

import os
import select
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

LOOK_MS = 5


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


def end(process: int, number: int, most_s: float) -> ExitTime | None:
    """Send a signal and return how long the process took to end; None if it did not within the time."""
    descriptor = os.pidfd_open(process)
    try:
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        before, waited_s = waits_ns(process), 0.0
        start_s = last_s = time.monotonic()
        os.kill(process, number)
        while True:
            ended = poll.poll(LOOK_MS)
            now_s, waits = time.monotonic(), waits_ns(process)
            longest_ns = max(waits[thread] - before.get(thread, 0) for thread in waits)
            waited_s += min(longest_ns * 1e-9, now_s - last_s)
            before, last_s = waits, now_s
            if ended:
                return ExitTime(now_s - start_s, waited_s)
            if now_s - start_s - waited_s > most_s:
                return None
    finally:
        os.close(descriptor)
