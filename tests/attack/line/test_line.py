"""The short form of the attacks over the line, and that what they look for would be seen."""

import pytest

from ..short import short_form
from . import wire
from .damage import packet
from .line import FLAT

pytestmark = pytest.mark.heavy

outcome, test_it_is_withstood = short_form("line")


def test_a_changed_scan_and_a_missing_one_would_be_seen():
    doubled = wire.stream(lambda line, _: packet(line.payload(counts=line.rng.normal(2 * FLAT, 9).astype("i4"))), 20)
    assert doubled.wrong(exact=True, content=True)
    seen = wire.stream(lambda _, payload: packet(payload), 20)
    assert not seen.wrong(exact=True, content=True)
    del seen.published[30]
    assert seen.wrong(exact=True, content=True)
