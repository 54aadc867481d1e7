"""The short form, in three parts; ``make attack`` runs the long one."""

import signal

import pytest

from ..outcome import Effort
from .exit_time import ExitTime, Waits, union_s
from .judged import judge
from .moments import CTRL_C, LIVES, MOMENTS, at_moments

PARTS = (
    ["start", "capture", "stream", "control", "start"],
    ["silent", "unplugged"],
    ["curve", "verify_idle", "verify_always"],
)


def test_the_parts_are_the_whole():
    assert {life for part in PARTS for life in part} == set(LIVES)


def test_waits_of_several_threads_at_once_count_once():
    assert union_s([]) == 0.0
    assert union_s([(3.0, 4.0), (0.0, 1.0), (0.5, 2.0), (0.6, 0.7), (3.0, 4.0)]) == 3.0


def test_a_wait_is_seen_though_the_thread_is_gone_before_it_is_counted(tmp_path):
    def told(thread, ran_ns, waited_ns, state):
        folder = tmp_path / thread
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "schedstat").write_text(f"{ran_ns} {waited_ns} 3\n")
        (folder / "stat").write_text(f"8 (a) b) {state} 1 2\n")

    told("thread-self", 1, 1, "R")
    told("7/task/7", 100, 50, "S")
    told("7/task/8", 100, 50, "R")
    waits = Waits(7, 10.0, tmp_path)
    waits.look(10.2)  # ready, and did not run: no core
    told("7/task/8", 101, 50, "R")
    waits.look(10.3)  # it ran
    waits.look(10.4)
    assert union_s(waits.spans) == pytest.approx(0.3)
    for name in ("schedstat", "stat"):
        (tmp_path / "7" / "task" / "8" / name).unlink()
    told("7/task/7", 100, 50_000_050, "S")  # a wait of 50 ms that is over
    waits.look(10.5)
    waits.look(10.6)
    assert union_s(waits.spans) == pytest.approx(0.35)


def test_a_thousand_moments_are_by_sigterm():
    assert MOMENTS * (CTRL_C - 1) // CTRL_C == 1000


@pytest.mark.parametrize(
    ("number", "status", "text"),
    [
        (signal.SIGTERM, -signal.SIGTERM, ""),  # nothing was open yet
        (signal.SIGINT, 128 + signal.SIGINT, ""),
        (signal.SIGTERM, 0, '{"frames": 7}'),
    ],
)
def test_who_takes_longer_than_a_second_is_found_wherever_its_life_ended(number, status, text):
    assert judge("start", number, status, ExitTime(5.0, 4.5), text) == ""
    assert "1.50 s of its own" in judge("start", number, status, ExitTime(1.5, 0.0), text)


@pytest.mark.process
@pytest.mark.heavy
@pytest.mark.parametrize("part", [0, 1, 2])
def test_a_runtime_ends_cleanly_within_a_second_whenever_it_is_told_to(part):
    outcome = at_moments(Effort(seed=part), PARTS[part])
    assert outcome.held, outcome.as_dict()
