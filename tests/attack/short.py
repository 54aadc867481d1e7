"""Tests of the short form of attacks, which a folder's test module makes for its own."""

from collections.abc import Callable
from typing import Any, Final

import pytest

from .catalogue import ATTACKS, load
from .outcome import Effort, Outcome

SLOW: Final = frozenset({
    "subscribers.held", "subscribers.without-keys", "subscribers.honest", "front-end.hanging",
    "files.readers", "run.terminated",
})  # fmt: skip
"""Whose short form takes five seconds and more: ``make slow`` has them, not ``make test``."""


def short_form(folder: str) -> tuple[Any, Callable[[Outcome], None]]:
    """Return a fixture, the outcome of every attack of a folder by its name, and the test that it was withstood.

    What an attack costs is the attacker's time and that of other processes, so it is spent in the fixture.

    Args:
        folder: Below this one, as the catalogue has it.
    """
    names = [name for name, where in ATTACKS.items() if where.startswith(f"{folder}.")]
    assert names, f"no attack is in {folder}"
    params = [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in names]

    @pytest.fixture(scope="module", params=params)
    def outcome(request: pytest.FixtureRequest) -> Outcome:
        found = load(request.param)(Effort())
        assert found.attack == request.param
        return found

    def it_is_withstood(outcome: Outcome) -> None:
        assert outcome.held, outcome.as_dict()

    return outcome, it_is_withstood
