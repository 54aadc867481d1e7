"""Every attack on subscribers in its short form."""

import pytest

from ..catalogue import ATTACKS, load
from ..outcome import Effort


@pytest.mark.process
@pytest.mark.heavy
@pytest.mark.parametrize("name", [name for name, where in ATTACKS.items() if where.startswith("subscribers.")])
def test_an_attack_on_subscribers_is_withstood(name):
    outcome = load(name)(Effort())
    assert outcome.held, outcome.as_dict()
