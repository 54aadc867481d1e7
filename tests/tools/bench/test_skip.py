"""The skip benchmark's own arithmetic; that the skips themselves are right is tested with the runtime."""

from __future__ import annotations

import time

import pytest

from eitskin_tools.bench.skip import FRAMES_PER_TURN, interleaved, saving
from eitskin_tools.cli import main


class Busy:
    """A way that keeps the processor busy for so long, and notes when it had its turn."""

    def __init__(self, name: str, order: list[str], seconds: float) -> None:
        self.name, self.order, self.seconds = name, order, seconds
        self.prepared: list[int] = []

    def prepare(self, index: int) -> None:
        self.prepared.append(index)

    def __call__(self) -> None:
        self.order.append(self.name)
        until_ns = time.thread_time_ns() + int(self.seconds * 1e9)
        while time.thread_time_ns() < until_ns:
            pass


def test_ways_take_turns_and_every_frame_is_prepared_once() -> None:
    order: list[str] = []
    ways = {"with": Busy("with", order, 0.0), "without": Busy("without", order, 0.0)}
    interleaved(dict(ways), 2 * FRAMES_PER_TURN + 3)
    assert order[:2] == ["with", "without"]  # warm
    assert (
        order[2:] == (["with"] * FRAMES_PER_TURN + ["without"] * FRAMES_PER_TURN) * 2 + ["with"] * 3 + ["without"] * 3
    )
    assert ways["with"].prepared == list(range(2 * FRAMES_PER_TURN + 3))


def test_what_is_saved_is_the_difference_of_processor_time_not_of_waiting() -> None:
    order: list[str] = []
    times = interleaved({"with": Busy("with", order, 0.0), "without": Busy("without", order, 1e-3)}, 10)
    row = saving(times)
    assert row["cpu_saved_us"] > 900  # a busy millisecond, less what reading the clock takes
    assert row["cpu_left"] < 0.2
    assert times["without"]["cpu_p50"] >= 1000


def test_too_few_frames_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "skip", "--frames", "3"]) == 2
    assert "at least" in capsys.readouterr().err
