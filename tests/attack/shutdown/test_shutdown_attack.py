"""The short form: each life once, one in five by Ctrl-C."""

import pytest

from ..short import short_form

pytestmark = [pytest.mark.process, pytest.mark.heavy]

outcome, test_a_runtime_ends_cleanly_whenever_it_is_told_to = short_form("shutdown")
