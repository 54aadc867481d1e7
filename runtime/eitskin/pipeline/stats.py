"""What a run was like: latencies of the last frames by stage, and counts of everything that was decided.

Stamps go into a ring that is made once, so that a run of days costs as much memory as one of minutes. A tail is
reported as p50, p99, p99.9 and maximum; a mean would hide it.

What comes behind publishing is no frame's latency, but the next frame's: it is told apart, and so is what was left. ::

    read ... publish | streams | rest | ready ........ left ........ read ... publish
"""

import struct
import time
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.messaging.frame import STAGES

RING: Final = 1 << 14
"""Frames whose stamps are kept: 82 s at 200 frames/s, 0.9 MB."""


TOLD, READY = len(STAGES), len(STAGES) + 1
"""Behind the stages: when streams had been told of the frame, and when the loop was ready for the next one."""

_STAMPS: Final = struct.Struct(f"={READY + 1}q")
_READY: Final = struct.Struct("=q")


class Statistics:
    """Counts and stamps of one run."""

    def __init__(self, capacity: int = RING) -> None:
        self._stamps = np.empty((capacity, READY + 1), dtype=np.int64)
        self._stamps[:] = 0  # written now, so that the kernel gives the pages now and not frame by frame
        self._memory = self._stamps.data.cast("B")
        self.frames = 0
        """Frames that went through, published or not."""
        self.touched = 0
        self.first_ns = 0
        self.first_cpu_ns = 0
        """CPU time of the process, all its threads, when the first frame had been published."""
        self.last_ns = 0
        self.solvers: dict[str, int] = {}
        self.skipped: dict[str, int] = {}
        self.events: dict[str, int] = {}

    def add(
        self,
        stamps: list[int],
        told_ns: int,
        solver: str,
        touched: bool,
        skipped: tuple[str, ...],
        events: tuple[str, ...],
    ) -> None:
        """Take note of a frame.

        Args:
            stamps: ``perf_counter_ns`` at the end of each of ``STAGES``.
            told_ns: When streams had been told of it.
            solver: Name of the engine, or ``none``.
            touched: What the gate said.
            skipped: What was left out.
            events: What happened.
        """
        _STAMPS.pack_into(self._memory, _STAMPS.size * (self.frames % len(self._stamps)), *stamps, told_ns, 0)
        if self.frames == 0:
            self.first_ns = stamps[0]
            self.first_cpu_ns = time.process_time_ns()
        self.last_ns = stamps[0]
        self.frames += 1
        self.touched += touched
        self.solvers[solver] = self.solvers.get(solver, 0) + 1
        for name in skipped:
            self.skipped[name] = self.skipped.get(name, 0) + 1
        for name in events:
            self.events[name] = self.events.get(name, 0) + 1

    def ready(self, now_ns: int) -> None:
        """Take note that all is done that the frame which was added last brought with it."""
        row = (self.frames - 1) % len(self._stamps)
        _READY.pack_into(self._memory, _STAMPS.size * (row + 1) - _READY.size, now_ns)

    def summary(self) -> dict[str, Any]:
        """Return counts, rate and latencies as plain numbers."""
        first = self.frames % len(self._stamps) if self.frames > len(self._stamps) else 0
        seen = np.roll(self._stamps[: min(self.frames, len(self._stamps))], -first, axis=0)  # the oldest first
        publish, told, ready = seen[:, TOLD - 1], seen[:, TOLD], seen[:, READY]
        done = ready > 0  # not the last one, of a loop that was left while it handed that over
        elapsed_s = (self.last_ns - self.first_ns) * 1e-9
        return {
            "frames": self.frames,
            "rate_hz": round((self.frames - 1) / elapsed_s, 3) if elapsed_s > 0 else 0.0,
            "touched": self.touched,
            "cpu_us_per_frame": round((time.process_time_ns() - self.first_cpu_ns) / 1000 / max(self.frames - 1, 1), 1),
            "latency_us": quantiles((publish - seen[:, 0]) / 1000),
            "stages_us": {
                stage: quantiles((seen[:, column + 1] - seen[:, column]) / 1000)
                for column, stage in enumerate(STAGES[1:])
            },
            "behind_us": {
                "streams": quantiles((told - publish) / 1000),
                "rest": quantiles((ready - told)[done] / 1000),
            },
            "left_us": lower_quantiles((seen[1:, 0] - ready[:-1])[done[:-1]] / 1000),
            "solvers": dict(self.solvers),
            "skipped": dict(self.skipped),
            "events": dict(self.events),
        }


def quantiles(spans: npt.NDArray[np.float64]) -> dict[str, float]:
    """Return p50, p99, p999 and max, rounded to 0.1; zeros for no spans."""
    if spans.size == 0:
        return {"p50": 0.0, "p99": 0.0, "p999": 0.0, "max": 0.0}
    p50, p99, p999 = np.percentile(spans, [50, 99, 99.9])
    found = {"p50": p50, "p99": p99, "p999": p999, "max": spans.max()}
    return {name: round(float(value), 1) for name, value in found.items()}


def lower_quantiles(spans: npt.NDArray[np.float64]) -> dict[str, float]:
    """Return p50, p1 and min, rounded to 0.1, of times of which the short ones matter; zeros for no spans."""
    if spans.size == 0:
        return {"p50": 0.0, "p1": 0.0, "min": 0.0}
    p50, p1 = np.percentile(spans, [50, 1])
    return {name: round(float(value), 1) for name, value in {"p50": p50, "p1": p1, "min": spans.min()}.items()}
