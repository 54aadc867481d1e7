"""The short form of the attacks by numbers."""

import pytest

from ..outcome import Effort
from .denormals import denormals

pytestmark = pytest.mark.heavy


def test_no_denormal_reaches_a_solver() -> None:
    outcome = denormals(Effort())
    assert outcome.held, outcome.broken
