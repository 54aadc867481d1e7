"""The short form of the attacks on what a front end says."""

import pytest

from ..outcome import Effort
from .hanging import hanging
from .hello import hello
from .lies import honest, lies, references


@pytest.mark.heavy
@pytest.mark.parametrize("attack", [lies, honest, references, hello])
def test_what_no_front_end_says_goes_nowhere_and_what_an_honest_one_says_all_does(attack):
    outcome = attack(Effort())
    assert outcome.held, outcome.broken


@pytest.mark.heavy
def test_devices_that_hang_are_named_greeted_seldom_and_given_up_in_time():
    outcome = hanging(Effort())
    assert outcome.tried == 21
    assert outcome.held, outcome.broken
