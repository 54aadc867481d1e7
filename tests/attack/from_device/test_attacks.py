"""The short form of every attack from the device's side."""

import pytest

from ..catalogue import ATTACKS, load
from ..outcome import Effort

pytestmark = [pytest.mark.process, pytest.mark.heavy]


@pytest.mark.parametrize("name", [name for name, where in ATTACKS.items() if where.startswith("from_device.")])
def test_withstands(name: str) -> None:
    outcome = load(name)(Effort())
    assert outcome.attack == name
    assert outcome.held, outcome.as_dict()
