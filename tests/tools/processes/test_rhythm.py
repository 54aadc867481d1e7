"""When frames come, and how long to rest so as to wake between two of them."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from eitskin_tools.processes import rhythm as rhythms
from eitskin_tools.processes.rhythm import LONGEST_NS, SHARE, Rhythm

PERIOD_NS = 5_000_000
BEGIN_NS = 10**12


@pytest.fixture
def clock(monkeypatch):
    found = SimpleNamespace(now_ns=BEGIN_NS)
    monkeypatch.setattr(rhythms, "time", SimpleNamespace(perf_counter_ns=lambda: found.now_ns))
    return found


def told(period_ns, each=1, count=50, jitter_ns=0, seed=0):
    """A rhythm that was told of one frame in so many."""
    found, rng = Rhythm(), np.random.default_rng(seed)
    for number in range(0, count * each, each):
        found.heard(number, BEGIN_NS + number * period_ns + int(rng.integers(0, jitter_ns + 1)))
    return found


@pytest.mark.parametrize("each", [1, 7])
@pytest.mark.parametrize("least_s", [0.0, 0.02, 1 / 30])
def test_whoever_rests_wakes_when_a_frame_is_through(clock, each, least_s):
    rhythm = told(PERIOD_NS, each)
    for step in range(40):
        clock.now_ns = BEGIN_NS + 50 * each * PERIOD_NS + step * 777_777
        rest_s = rhythm.rest_s(least_s)
        assert least_s <= rest_s <= least_s + PERIOD_NS * 1e-9 + 1e-9
        wakes_ns = clock.now_ns + rest_s * 1e9 - BEGIN_NS
        assert abs(wakes_ns / PERIOD_NS % 1.0 - SHARE) < 1e-3


def test_frames_that_come_unevenly_are_met_all_the_same(clock):
    rhythm = told(PERIOD_NS, jitter_ns=PERIOD_NS // 10)
    clock.now_ns = BEGIN_NS + 50 * PERIOD_NS
    wakes_ns = clock.now_ns + rhythm.rest_s(0.02) * 1e9 - BEGIN_NS
    assert 0.2 < wakes_ns / PERIOD_NS % 1.0 < 0.7  # neither while one is computed nor when the next one comes


@pytest.mark.parametrize(
    "rhythm",
    [
        Rhythm(),
        told(1_000_000),  # no time between two
        told(2 * LONGEST_NS),  # nobody waits so long for a good moment
        told(-PERIOD_NS),  # a clock of something else
        told(0),
    ],
    ids=["nothing heard", "too fast", "too slow", "backwards", "at once"],
)
def test_where_there_is_no_rhythm_one_rests_as_long_as_one_would(clock, rhythm):
    assert rhythm.rest_s(0.02) == 0.02


def test_a_stream_that_begins_anew_has_its_own_rhythm(clock):
    rhythm = told(PERIOD_NS)
    rhythm.heard(0, BEGIN_NS)  # another run
    assert rhythm.rest_s(0.02) == 0.02
    for number in range(1, 30):
        rhythm.heard(number, BEGIN_NS + number * 2 * PERIOD_NS)
    clock.now_ns = BEGIN_NS + 60 * PERIOD_NS
    assert (clock.now_ns + rhythm.rest_s(0.0) * 1e9 - BEGIN_NS) / (2 * PERIOD_NS) % 1.0 == pytest.approx(
        SHARE, abs=1e-3
    )


def test_a_stream_that_stopped_long_ago_keeps_nobody_longer(clock):
    rhythm = told(PERIOD_NS)
    clock.now_ns = BEGIN_NS + 10**13
    assert 0.02 <= rhythm.rest_s(0.02) <= 0.02 + PERIOD_NS * 1e-9 + 1e-9


def test_it_asks_the_clock_that_frames_are_stamped_with():
    rhythm, now_ns = Rhythm(), time.perf_counter_ns()
    for number in range(10):
        rhythm.heard(number, now_ns + (number - 10) * PERIOD_NS)
    assert 0.0 <= rhythm.rest_s(0.0) <= PERIOD_NS * 1e-9
