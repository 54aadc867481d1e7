"""The short form of the attack by numbers."""

import pytest

from ..short import short_form

pytestmark = pytest.mark.heavy

outcome, test_no_number_is_slow_to_compute = short_form("numbers")
