"""The short form: some hundreds of damaged files, read or refused in a line."""

import random

import pytest

from ..short import short_form
from .kinds import KINDS

pytestmark = [pytest.mark.process, pytest.mark.heavy]

outcome, test_damaged_files_are_read_or_refused_within_bounds = short_form("files")


@pytest.mark.parametrize("kind", ["robot", "skin", "reference"])
def test_whatever_is_drawn_damages_a_file(kind, tmp_path):
    for seed in range(100):
        folder = tmp_path / str(seed)
        folder.mkdir()
        _, what = KINDS[kind].make(folder, random.Random(seed))
        assert what
