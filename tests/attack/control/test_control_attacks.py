"""The short forms; ``make attack`` runs the long ones."""

import pytest

from ..short import short_form

pytestmark = [pytest.mark.process, pytest.mark.heavy]

outcome, test_nobody_is_let_in_kept_waiting_or_costs_a_frame = short_form("control")
