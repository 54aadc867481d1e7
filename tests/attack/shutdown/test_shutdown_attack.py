"""The short form, in two halves; ``make attack`` runs the long one."""

import pytest

from ..outcome import Effort
from .exit_time import union_s
from .moments import LIVES, at_moments

HALVES = (["start", "capture", "stream", "control", "start"], ["regions", "silent", "unplugged", "regions"])


def test_the_halves_are_the_whole():
    assert {life for half in HALVES for life in half} == set(LIVES)


def test_waits_of_several_threads_at_once_count_once():
    assert union_s([]) == 0.0
    assert union_s([(3.0, 4.0), (0.0, 1.0), (0.5, 2.0), (0.6, 0.7), (3.0, 4.0)]) == 3.0


@pytest.mark.process
@pytest.mark.heavy
@pytest.mark.parametrize("half", [0, 1])
def test_a_runtime_ends_cleanly_within_a_second_whenever_it_is_told_to(half):
    outcome = at_moments(Effort(seed=half), HALVES[half])
    assert outcome.held, outcome.as_dict()
