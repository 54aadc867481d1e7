"""Every attack on subscribers in its short form."""

import pytest

from ..short import short_form

pytestmark = [pytest.mark.process, pytest.mark.heavy]

outcome, test_it_is_withstood = short_form("subscribers")
