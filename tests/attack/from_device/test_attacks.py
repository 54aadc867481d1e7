"""The short form of every attack from the device's side."""

import pytest

from ..short import short_form

pytestmark = [pytest.mark.process, pytest.mark.heavy]

outcome, test_it_is_withstood = short_form("from_device")
