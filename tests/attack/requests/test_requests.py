"""The short form of the attacks by requests and by a device's answers."""

import pytest

from ..line.damage import packet
from ..short import short_form
from .hostile_device import MOST_REQUESTS, EndlessError, HostileDevice

pytestmark = [pytest.mark.process, pytest.mark.heavy]

outcome, test_it_is_withstood = short_form("requests")


def test_a_host_that_asks_without_end_is_noticed() -> None:
    device = HostileDevice(["noise"])
    with pytest.raises(EndlessError):
        device.write(packet(b"\x01\x01EITS\x01\x00") * (MOST_REQUESTS + 1))
