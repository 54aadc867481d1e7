import pytest

from eitskin_tools.emulator.device_core import HostDevice, library
from eitskin_tools.emulator.firmware import missing_tools


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
