"""CPU time of a frame with a skip and without it, taken in turns in one run, so that both see the same machine.

Thread CPU time, not wall time: what a busy machine takes away is not counted. Each way takes frames through a pipeline;
ways change places every ``TURN`` frames. Making a frame's payload is no part of what is measured.
"""

import time
from typing import Any, Final, Protocol

import numpy as np

TURN: Final = 10
"""Frames of one way before the other has its turn."""


class Way(Protocol):
    """One way to take frames."""

    def prepare(self, index: int) -> None:
        """Make frame number i."""

    def __call__(self) -> object:
        """Take it."""


def interleaved(ways: dict[str, Way], frames: int) -> dict[str, dict[str, float]]:
    """Return mean, median and 99th percentile of every way's CPU time a frame, and the median wall time, in us.

    Args:
        ways: By name.
        frames: Of each.
    """
    cpu: dict[str, list[int]] = {name: [] for name in ways}
    wall: dict[str, list[int]] = {name: [] for name in ways}
    for way in ways.values():
        way()  # the frame that it was made with; the first is slower
    for start in range(0, frames, TURN):
        for name, way in ways.items():
            for index in range(start, min(start + TURN, frames)):
                way.prepare(index)
                wall_ns, cpu_ns = time.perf_counter_ns(), time.thread_time_ns()
                way()
                cpu[name].append(time.thread_time_ns() - cpu_ns)
                wall[name].append(time.perf_counter_ns() - wall_ns)
    return {
        name: {
            "cpu_mean": round(float(np.mean(cpu[name])) / 1e3, 2),
            "cpu_p50": round(float(np.median(cpu[name])) / 1e3, 2),
            "cpu_p99": round(float(np.quantile(cpu[name], 0.99)) / 1e3, 2),
            "wall_p50": round(float(np.median(wall[name])) / 1e3, 2),
        }
        for name in ways
    }


def saving(times: dict[str, dict[str, float]]) -> dict[str, Any]:
    """Return the times of "with" and "without", and what lies between: mean CPU a frame in us, and the share left."""
    one, other = times["with"]["cpu_mean"], times["without"]["cpu_mean"]
    return {"us": times, "cpu_saved_us": round(other - one, 2), "cpu_left": round(one / other, 4)}
