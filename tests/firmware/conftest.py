import pytest
from tests.emulator.device_core import HostDevice, library
from tests.emulator.firmware import missing_tools

from .asked import DEVICES


@pytest.fixture(scope="session")
def core():
    missing = missing_tools("host")
    if missing:
        pytest.skip(f"the C core needs {', '.join(missing)}: apt-get install build-essential")
    return library()


@pytest.fixture
def device(core):
    made = HostDevice()
    made.run(1000)
    made.take()
    return made


def _asked(name, folder):
    made, needs = DEVICES[name]
    missing = missing_tools(needs) if needs else []
    if missing:
        pytest.skip(f"{', '.join(missing)} not found: see tools/system-packages.sh")
    device = made(folder)
    try:
        yield device
    finally:
        device.close()


@pytest.fixture(params=["core", "virtual", pytest.param("board", marks=pytest.mark.process)])
def asked(request, tmp_path):
    """Return each device in turn."""
    yield from _asked(request.param, tmp_path)


@pytest.fixture(params=["core", "virtual"])
def clocked(request, tmp_path):
    """Return those whose clock a test can move; an emulator keeps no times, and boots for each of many cases."""
    yield from _asked(request.param, tmp_path)
