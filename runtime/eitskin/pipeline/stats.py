"""Statistics of a run: latencies of the last frames by stage, and counts of all decisions.

Stamps go into a ring that is made once, so that a run of days costs as much memory as one of minutes. A tail is
reported as p50, p99, p99.9 and maximum; a mean would hide it.

Work after publishing delays the next frame, not this one; it is reported separately, and so is the remaining time. ::

    read ... publish | rest | gives way | streams | ........ left ........ read ... publish
"""

import struct
import time
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.frame_record import STAGES

RING: Final = 1 << 14
"""Frames whose stamps are kept: 82 s at 200 frames/s, 0.9 MB."""


TOLD, REST, READY = (len(STAGES) + index for index in range(3))
"""After the stages: time of the streams and of the rest, in ns, and the end of all."""

_STAMPS: Final = struct.Struct(f"={READY + 1}q")


class Statistics:
    """Counts and stamps of one run."""

    def __init__(self) -> None:
        self._stamps = np.empty((RING, READY + 1), dtype=np.int64)
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
        solver: str,
        touched: bool,
        skipped: tuple[str, ...],
        events: tuple[str, ...],
    ) -> None:
        """Take note of a frame.

        Args:
            stamps: ``perf_counter_ns`` at the end of each of ``STAGES``.
            solver: Name of the engine, or ``none``.
            touched: The gate's decision.
            skipped: The saved computation.
            events: Its events.
        """
        _STAMPS.pack_into(self._memory, _STAMPS.size * (self.frames % len(self._stamps)), *stamps, 0, 0, 0)
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
        """Record that the frame added last is finished, except for the streams."""
        row = self._stamps[(self.frames - 1) % len(self._stamps)]
        row[REST], row[READY] = now_ns - row[TOLD - 1], now_ns

    def told(self, begin_ns: int, end_ns: int) -> None:
        """Record that the streams have sent the frame added last."""
        row = self._stamps[(self.frames - 1) % len(self._stamps)]
        row[TOLD], row[READY] = end_ns - begin_ns, end_ns

    def summary(self) -> dict[str, Any]:
        """Return counts, rate and latencies as plain numbers."""
        first = self.frames % len(self._stamps) if self.frames > len(self._stamps) else 0
        seen = np.roll(self._stamps[: min(self.frames, len(self._stamps))], -first, axis=0)  # the oldest first
        publish, told, rest, ready = seen[:, TOLD - 1], seen[:, TOLD], seen[:, REST], seen[:, READY]
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
                "streams": quantiles(told / 1000),
                "rest": quantiles(rest[done] / 1000),
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
