"""The skip benchmark's own arithmetic; that the skips themselves are right is tested with the runtime."""

from __future__ import annotations

import time

import numpy as np
import pytest

from eitskin_tools.bench.skip import waking
from eitskin_tools.bench.skip.cost import TURN, interleaved, saving
from eitskin_tools.bench.skip.gate_error import bound
from eitskin_tools.bench.skip.scenes import Motion, contrasts_of_growth, first_above
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
    interleaved(dict(ways), 2 * TURN + 3)
    assert order[:2] == ["with", "without"]  # warm
    assert order[2:] == (["with"] * TURN + ["without"] * TURN) * 2 + ["with"] * 3 + ["without"] * 3
    assert ways["with"].prepared == list(range(2 * TURN + 3))


def test_what_is_saved_is_the_difference_of_processor_time_not_of_waiting() -> None:
    order: list[str] = []
    times = interleaved({"with": Busy("with", order, 0.0), "without": Busy("without", order, 1e-3)}, 10)
    row = saving(times)
    assert row["cpu_saved_us"] > 900  # a busy millisecond, less what reading the clock takes
    assert row["cpu_left"] < 0.2
    assert times["without"]["cpu_p50"] >= 1000


def test_a_motion_passes_its_keys_and_is_straight_between_them() -> None:
    keys = np.arange(3.0)[:, None] ** 2 * np.ones(104)
    frames = Motion("A", keys).frames(5)
    np.testing.assert_allclose(frames[:, 0], [0.0, 0.5, 1.0, 2.5, 4.0], atol=1e-12)


def test_a_touch_grows_from_nothing_to_the_weakest_contrast() -> None:
    contrasts = contrasts_of_growth()
    assert contrasts[0] == 1.0
    assert contrasts[-1] == pytest.approx(20.0)
    assert first_above([False, False, True, True]) == 2
    assert first_above([False]) is None


def test_a_test_misses_half_where_a_touch_is_as_large_as_the_threshold() -> None:
    from scipy.stats import norm

    from eitskin_training.gate.fit import FALSE_ALARM_RATE

    reference, untouched = np.ones(104), np.zeros((1, 104))
    # N2 has a standard deviation of 10^-2.5 in every row, so equal steps of z / sqrt(104) of it are z in all.
    step = norm.isf(FALSE_ALARM_RATE) * 10**-2.5 / np.sqrt(104)
    assert bound(untouched + step, untouched, reference)["N2"] == pytest.approx(0.5, abs=1e-3)
    assert bound(untouched + 3 * step, untouched, reference)["N2"] < 1e-6
    # A deformation that looks the same hides it: then only false alarms are seen.
    same = np.ones((104, 104))
    hidden = bound(untouched + 3 * step, untouched, reference, same)["N2"]
    assert hidden == pytest.approx(1.0 - FALSE_ALARM_RATE, abs=1e-3)


@pytest.mark.parametrize("options", [["--frames", "3"], ["--bends", "1"], ["--touches", "0"]])
def test_too_few_frames_or_bends_are_refused(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "skip", *options]) == 2
    assert "at least" in capsys.readouterr().err


def test_touches_fall_evenly_into_the_idle_period_and_the_source_shows_them() -> None:
    begins = waking.begins_s(40)
    assert (np.diff(begins) > waking.HELD_S + waking.AFTER_S).all()  # asleep again in between
    phases = np.sort((begins - waking.FIRST_S - waking.EVERY_S * np.arange(40)) / waking.SPREAD_S)
    np.testing.assert_allclose(phases, np.arange(40) / 40, atol=0.05)  # within two places of evenly spaced
    source = waking.Touched(np.zeros((2, 104)), np.ones((3, 104)), 40)
    for begin in begins:
        assert not source.voltages(begin - 1e-6).any()
        assert source.voltages(begin + 1e-6).all()
        assert not source.voltages(begin + waking.HELD_S + 1e-6).any()


def test_a_wait_ends_with_the_first_whole_frame_that_shows_the_touch() -> None:
    ms = 1_000_000
    stream = [(0, 0, 1), (50, 0, 1), (100, 0, 1), (150, 1, 1), (156, 0, 0), (161, 1, 0), (166, 1, 0)]
    seen = np.array(stream, dtype=np.int64) * [ms, 1, 1] + [10_000 * ms, 0, 0]
    found = waking.waits(seen, 10_000 * ms, np.array([0.09, 0.158, 5.0]))
    assert found["ms"] == {"mean": 71.0, "p50": 71.0, "largest": 71.0}
    assert found["frames_that_missed_it"] == 2  # that at 100 ms, and the whole one at 156
    assert found["awake_already"] == 2
    assert found["never_met"] == 0
    assert waking.waits(seen[:4], 10_000 * ms, np.array([0.09]))["never_met"] == 1
