"""The short forms: some hundreds of damaged files, read or refused in a line."""

import pytest
from tests.attack.catalogue import load
from tests.attack.outcome import Effort


@pytest.mark.process
@pytest.mark.heavy
@pytest.mark.parametrize("name", ["files", "runs", "command-line"])
def test_damaged_files_are_read_or_refused_within_bounds(name: str) -> None:
    outcome = load(name)(Effort())
    assert outcome.held, outcome.broken
