"""The short form: some hundreds of damaged files, read or refused in a line."""

import pytest

from ..short import short_form

pytestmark = [pytest.mark.process, pytest.mark.heavy]

outcome, test_damaged_files_are_read_or_refused_within_bounds = short_form("files")
