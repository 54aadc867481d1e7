"""The short form of the attacks by requests and by a device's answers."""

import pytest
from tests.emulator.firmware import missing_tools

from ..outcome import Effort, Outcome
from .flashing import flashing
from .hostile_device import MOST_REQUESTS, Endless, HostileDevice, packed
from .sequences import board_requests, requests


def held(outcome: Outcome) -> None:
    assert outcome.held, outcome.broken


@pytest.mark.heavy
def test_flashing_ends_and_believes_no_lie() -> None:
    held(flashing(Effort()))


@pytest.mark.heavy
def test_no_sequence_of_requests_and_cuts_loses_the_confirmed_configuration() -> None:
    if missing_tools("host"):
        pytest.skip(f"the C core needs {', '.join(missing_tools('host'))}: apt-get install build-essential")
    held(requests(Effort()))


@pytest.mark.process
def test_nor_does_one_on_the_emulated_board() -> None:
    if missing_tools("qemu"):
        pytest.skip(f"{', '.join(missing_tools('qemu'))} not found: see tools/system-packages.sh")
    held(board_requests(Effort()))


def test_whoever_asks_without_end_is_noticed() -> None:
    device = HostileDevice(["no data"])
    with pytest.raises(Endless):
        device.write(packed(b"\x01\x01EITS\x01\x00") * (MOST_REQUESTS + 1))
