"""What a run was like: latencies of the last frames by stage, and counts of everything that was decided.

Stamps go into a ring that is made once, so that a run of days costs as much memory as one of minutes. A tail is
reported as p50, p99, p99.9 and maximum; a mean would hide it.
"""

import struct
import time
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.messaging.frame import STAGES

RING: Final = 1 << 14
"""Frames whose stamps are kept: 82 s at 200 frames/s, 0.9 MB."""


_STAMPS: Final = struct.Struct(f"={len(STAGES)}q")


class Statistics:
    """Counts and stamps of one run."""

    def __init__(self, capacity: int = RING) -> None:
        self._stamps = np.empty((capacity, len(STAGES)), dtype=np.int64)
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
        self, stamps: list[int], solver: str, touched: bool, skipped: tuple[str, ...], events: tuple[str, ...]
    ) -> None:
        """Take note of a frame.

        Args:
            stamps: ``perf_counter_ns`` at the end of each of ``STAGES``.
            solver: Name of the engine, or ``none``.
            touched: What the gate said.
            skipped: What was left out.
            events: What happened.
        """
        _STAMPS.pack_into(self._memory, _STAMPS.size * (self.frames % len(self._stamps)), *stamps)
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

    def summary(self) -> dict[str, Any]:
        """Return counts, rate and latencies as plain numbers."""
        seen = self._stamps[: min(self.frames, len(self._stamps))]
        elapsed_s = (self.last_ns - self.first_ns) * 1e-9
        return {
            "frames": self.frames,
            "rate_hz": round((self.frames - 1) / elapsed_s, 3) if elapsed_s > 0 else 0.0,
            "touched": self.touched,
            "cpu_us_per_frame": round((time.process_time_ns() - self.first_cpu_ns) / 1000 / max(self.frames - 1, 1), 1),
            "latency_us": quantiles((seen[:, -1] - seen[:, 0]) / 1000),
            "stages_us": {
                stage: quantiles((seen[:, column + 1] - seen[:, column]) / 1000)
                for column, stage in enumerate(STAGES[1:])
            },
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
