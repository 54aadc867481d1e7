"""The short form; ``make attack`` runs the long one."""

import pytest

from ..catalogue import load
from ..outcome import Effort


@pytest.mark.process
@pytest.mark.heavy
def test_a_runtime_ends_cleanly_within_a_second_whenever_it_is_told_to():
    outcome = load("shutdown")(Effort())
    assert outcome.held, outcome.as_dict()
