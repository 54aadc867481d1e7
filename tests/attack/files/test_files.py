"""The short forms: some hundreds of damaged files, read or refused in a line."""

import pytest
from tests.attack.catalogue import load
from tests.attack.outcome import Effort, Outcome

pytestmark = [pytest.mark.process, pytest.mark.heavy]


@pytest.fixture(scope="module", params=["files.readers", "files.runs", "files.commands"])
def outcome(request: pytest.FixtureRequest) -> Outcome:
    """Of an attack: its processes import for seconds, each all that a kind of file needs."""
    return load(request.param)(Effort())


def test_damaged_files_are_read_or_refused_within_bounds(outcome: Outcome) -> None:
    assert outcome.held, outcome.broken
