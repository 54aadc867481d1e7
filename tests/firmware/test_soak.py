import json

import pytest
from tests.emulator.firmware import missing_tools
from tests.faults import soak


@pytest.mark.process
@pytest.mark.parametrize(("seconds", "more_than"), [(2, 0), pytest.param(20, 200, marks=pytest.mark.slow)])
def test_every_number_of_a_stream_from_the_emulated_board_arrives_or_is_counted(capsys, seconds, more_than):
    missing = missing_tools("qemu")
    if missing:
        pytest.skip(f"{', '.join(missing)} not found: apt-get install gcc-arm-none-eabi qemu-system-arm")
    assert soak.main(["--seconds", str(seconds)]) == 0
    figures = json.loads(capsys.readouterr().out)["soak"]
    assert figures["frames"] > more_than  # of 200 a second: how many, is how busy this machine is
    assert (figures["unaccounted"], figures["corrupt"], figures["resets"]) == (0, 0, 0)
    assert figures["missing"] <= figures["counted_by_device"]


@pytest.mark.parametrize(
    ("missing", "device", "corrupt", "left"), [(0, 0, 0, 0), (5, 5, 0, 0), (5, 3, 1, 0), (5, 2, 1, 1), (3, 0, 0, 3)]
)
def test_what_neither_the_device_nor_a_damaged_packet_explains_is_unaccounted(missing, device, corrupt, left):
    assert soak.unaccounted(missing, device, corrupt) == left
