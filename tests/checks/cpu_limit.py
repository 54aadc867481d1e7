"""A test without the marker ``slow`` may use three seconds of CPU time in its call, and no more.

CPU time, of this process and of the children that it waited for, and not time by the clock: beside other work a test
waits for its turn, which says nothing about the test. A machine may also be slow. So the limit is in seconds of a
machine that does a small known piece of work in ``NOMINAL_S``, and grows where that piece takes longer; it never
shrinks. The piece is timed at the start, and again when a test is over its limit: beside much other work everything
costs more CPU time than it did. The piece needs no cache, and so does not show all of that: where more wait for cores
than there are, a test may use half as much again.

A child counts as a whole when it is waited for, which may be long after the test that started it. So what a child had
used before a test began is no use of that test's.
"""

import os
import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

LIMIT_S: Final = 3.0
"""CPU seconds of a test's call."""

NOMINAL_S: Final = 0.008
"""CPU seconds that the known piece of work takes where the limit holds as it is."""


BESIDE: Final = 1.5
"""Times what a test may use while other work fills the caches."""


def cpu_s() -> float:
    """Return the CPU seconds of this process and of the children that it has waited for."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def children_s() -> dict[int, float]:
    """Return the CPU seconds so far of each child that was not waited for yet, by its process id.

    Those of a child's own children are in it as far as it has waited for them: what ``cpu_s`` grows by at its end.
    Empty where the system has no ``/proc`` of Linux's kind.
    """
    ticks = os.sysconf("SC_CLK_TCK")
    found = {}
    for children in Path("/proc/self/task").glob("*/children"):
        try:
            for pid in children.read_text().split():
                behind_name = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
                found[int(pid)] = sum(int(field) for field in behind_name[11:15]) / ticks  # utime to cstime of proc(5)
        except (FileNotFoundError, ProcessLookupError):  # this thread or that child has just ended
            continue
    return found


def _known_work_s() -> float:
    start_s = time.process_time()
    sum(i * i for i in range(200_000))
    return time.process_time() - start_s


def slowness() -> float:
    """Return how many times more CPU time is taken here: as the known piece of work says, and whether others work."""
    beside = BESIDE if os.getloadavg()[0] > (os.cpu_count() or 1) else 1.0
    return beside * max(1.0, min(_known_work_s() for _ in range(3)) / NOMINAL_S)


class CpuLimit:
    """Plugin that fails a test which used more CPU time than it may.

    Args:
        limit_s: CPU seconds where the known piece of work takes ``NOMINAL_S``.
    """

    def __init__(self, limit_s: float) -> None:
        self._nominal_s = limit_s
        self.limit_s = limit_s * slowness()
        """Of this machine."""

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """Time the call of a test that is not marked ``slow``; fixtures are not counted, since tests share them."""
        children_before_s, before_s = children_s(), cpu_s()
        yield
        used_s = cpu_s() - before_s
        if children_before_s:
            there = children_s()
            used_s -= sum(child_s for pid, child_s in children_before_s.items() if pid not in there)
        item.user_properties.append(("cpu_s", round(used_s, 2)))  # --junitxml writes it down
        if used_s <= self.limit_s or item.get_closest_marker("slow") is not None:
            return
        self.limit_s = max(self.limit_s, self._nominal_s * slowness())
        if used_s > self.limit_s:
            pytest.fail(
                f"used {used_s:.1f} s of CPU time, expected at most {self.limit_s:.1f} s: make it smaller, share its "
                "work in a fixture, or mark it slow",
                pytrace=False,
            )
