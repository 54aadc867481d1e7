"""The short form of every attack from the device's side."""

import pytest

from ..catalogue import ATTACKS, load
from ..outcome import Effort, Outcome

pytestmark = [pytest.mark.process, pytest.mark.heavy]


@pytest.fixture(scope="module", params=[name for name, where in ATTACKS.items() if where.startswith("from_device.")])
def outcome(request: pytest.FixtureRequest) -> Outcome:
    """Of an attack, named; what it costs is the attacker's time, and that of other processes."""
    found = load(request.param)(Effort())
    assert found.attack == request.param
    return found


def test_it_is_withstood(outcome: Outcome) -> None:
    assert outcome.held, outcome.as_dict()
