"""The short forms; ``make attack`` runs the long ones."""

import pytest

from ..catalogue import load
from ..outcome import Effort


@pytest.mark.process
@pytest.mark.heavy
def test_hostile_requests_cost_nobody_an_answer_or_a_frame():
    outcome = load("control.requests")(Effort())
    assert outcome.held, outcome.as_dict()


def test_who_enters_is_what_was_meant_whatever_a_folder_of_keys_holds():
    outcome = load("control.keys")(Effort())
    assert outcome.held, outcome.as_dict()
