"""When frames come, and how long to rest so as to wake between two of them."""

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
