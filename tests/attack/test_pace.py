"""A runtime that is slower than its device is judged as broken, an honest one is not, whatever else goes on."""

import os
import time

import pytest

from .from_device.trial import trial
from .outcome import Outcome
from .pace import ENOUGH, LEAST, LOOK_NS, Passed, Waits, pace
from .stream import EITSKIN
from .subscribers.ground import defended, status

PERIOD_NS = 5_000_000
SLOW_S = "0.006"


def passed(takes_ns, frames=400, late_ns=None):
    """Return what is seen of a runtime that takes so long a frame; ``late_ns(number)`` is when the line has it."""
    free_ns, seen = 0, []
    for number in range(frames):
        due_ns = number * PERIOD_NS
        wire_ns = due_ns + (late_ns(number) if late_ns else 0)
        free_ns = max(free_ns, wire_ns) + takes_ns(number)
        seen.append(Passed(number, number, due_ns, wire_ns, free_ns))
    return seen


def test_who_keeps_up_has_the_pace_of_the_device():
    assert pace(passed(lambda _: 1_000_000), 0) == 1.0


@pytest.mark.parametrize("takes_ms", [6, 7, 11])
def test_who_takes_longer_than_the_device_has_its_own(takes_ms):
    found = pace(passed(lambda _: takes_ms * 1_000_000), 0)
    assert found < LEAST
    assert found == pytest.approx(5 / takes_ms, abs=0.03)


def test_time_without_a_core_is_not_the_runtimes():
    kept_off_ns = 300_000_000
    seen = passed(lambda number: kept_off_ns if number == 200 else 1_000_000)
    assert pace(seen, 0) == 1.0, "it caught up"
    slowly = passed(lambda number: 8_000_000)
    assert pace(slowly, 400 * 3_000_000) > LEAST
    assert pace(slowly, 400 * 1_000_000) < LEAST


def test_a_device_that_is_late_is_not_the_runtimes_slowness():
    assert pace(passed(lambda _: 1_000_000, late_ns=lambda number: (number // 100) * 400_000_000), 0) == 1.0
    assert pace(passed(lambda _: 1_000_000, late_ns=lambda number: number * PERIOD_NS), 0) == 1.0


def test_what_is_left_out_is_not_published():
    seen = [one for one in passed(lambda _: 1_000_000) if one.sequence % 10]
    seen = [Passed(number, one.sequence, one.due_ns, one.wire_ns, one.published_ns) for number, one in enumerate(seen)]
    assert pace(seen, 0) == pytest.approx(0.9, abs=0.01)


def test_of_few_frames_there_is_none_and_that_does_not_hold():
    assert pace(passed(lambda _: 1_000_000, ENOUGH - 1), 0) is None
    outcome = Outcome("x")
    outcome.note_pace(None, "nothing came")
    outcome.note_pace(0.97, "well")
    outcome.note_pace(0.71, "slow")
    assert (outcome.tried, outcome.withstood, outcome.figures) == (3, 1, {"slowest_pace": 0.71})


def test_waits_are_those_of_the_first_thread(tmp_path, monkeypatch):
    schedstat = tmp_path / "schedstat"
    waits = Waits(os.getpid())
    waits.look(LOOK_NS)
    assert waits.total_ns == 0, "of what came before the first look nothing counts"
    monkeypatch.setattr(waits, "_schedstat", schedstat)
    before_ns = waits._last_ns
    schedstat.write_text(f"5 {before_ns + 3_000_000} 9\n")
    waits.look(LOOK_NS + 1)
    assert waits.total_ns == 0, "it was just looked at"
    waits.look(3 * LOOK_NS)
    assert waits.total_ns == 3_000_000
    schedstat.unlink()
    waits.look(5 * LOOK_NS)
    assert waits.total_ns == 3_000_000, "it has ended"


@pytest.mark.process
@pytest.mark.heavy
@pytest.mark.parametrize("where", ["", pytest.param("within", marks=pytest.mark.slow), "between"])
def test_a_runtime_that_sleeps_in_every_frame_is_broken_and_an_honest_one_is_not(where):
    outcome = Outcome("pace")
    program = ("-m", "tests.attack.slow", where, SLOW_S) if where else EITSKIN
    with defended(outcome, "left alone", program=program) as stream:
        first = status(stream)["frames"]
        while status(stream)["frames"] < first + 300:
            time.sleep(0.05)
    if where:
        assert outcome.figures["slowest_pace"] < LEAST
        assert [text for text in outcome.broken if "pace" in text] == outcome.broken
        assert outcome.tried - outcome.withstood == 1
    else:
        assert outcome.held, outcome.as_dict()


@pytest.mark.process
@pytest.mark.slow
def test_a_slow_runtime_is_broken_with_a_device_that_does_nothing_wrong():
    outcome = Outcome("pace")
    with trial(program=("-m", "tests.attack.slow", "between", "0.008")) as running:
        order = {"do": "heads", "field": "flags", "values": [2], "xor": True, "right": True, "seed": 0, "frames": 150}
        running.endure(outcome, within_s=60.0, **order)
    assert outcome.figures["slowest_pace"] < LEAST
    assert outcome.withstood == 0
    assert "pace" in outcome.broken[0]
    assert ";" not in outcome.broken[0].rpartition("}: ")[2], "it was nothing else"
