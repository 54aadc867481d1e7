"""How long the verifier's process is at what it computes, in time that it had, and whether that is too long.

A frame has its budget. Who is far beyond it hangs, unless the machine had no time for it: so only what the computing
thread computed or slept counts, and not what it waited for a core, nor what the whole process stood still.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

BEAT_S: Final = 0.1
"""Between two looks."""

MODEL_S: Final = 240.0
"""What a model of a surface may take: it takes some seconds, and a small computer many of them."""

LONGEST_STEP_S: Final = 2.0 * BEAT_S
"""What counts of the time between two looks: beyond it the process was stopped, or the machine asleep."""

WAITS: Final = "R"
"""State of a thread that computes, or waits for a core to."""

Had = Callable[[], float]


class Work:
    """What the computing thread is at.

    Args:
        had: Returns the seconds that it had since the last call.
    """

    def __init__(self, had: Had) -> None:
        self._had = had
        self._lock = threading.Lock()
        self._may_s: float | None = None
        self._spent_s = 0.0

    @contextmanager
    def within(self, may_s: float) -> Iterator[None]:
        """Compute something that may take so many seconds."""
        with self._lock:
            self._may_s, self._spent_s = may_s, 0.0
        try:
            yield
        finally:
            with self._lock:
                self._may_s = None

    def late_s(self) -> float:
        """Return the seconds beyond what it may take; 0 where it is not late, or at nothing."""
        had_s = self._had()
        with self._lock:
            if self._may_s is None:
                return 0.0
            self._spent_s += had_s
            return max(0.0, self._spent_s - self._may_s)


class TimeHad:
    """Counts what a thread of this process had, to be called by another one at each beat.

    Args:
        thread: Which; by default the one that makes this.
    """

    def __init__(self, thread: threading.Thread | None = None) -> None:
        thread = thread or threading.current_thread()
        assert thread.ident is not None
        self._clock = time.pthread_getcpuclockid(thread.ident)
        self._stat = Path(f"/proc/self/task/{thread.native_id}/stat")
        self._cpu_s, self._at_s = time.clock_gettime(self._clock), time.monotonic()

    def __call__(self) -> float:
        """Return the seconds since the last call in which it computed; all of them where it slept throughout."""
        cpu_s, at_s = time.clock_gettime(self._clock), time.monotonic()
        computed_s, passed_s = cpu_s - self._cpu_s, at_s - self._at_s
        self._cpu_s, self._at_s = cpu_s, at_s
        slept = computed_s == 0.0 and self._state() != WAITS
        return min(passed_s if slept else computed_s, LONGEST_STEP_S)

    def _state(self) -> str:
        with suppress(OSError):  # a machine without /proc: who did not compute at all slept
            return self._stat.read_text().rpartition(")")[2].split()[0]
        return ""
