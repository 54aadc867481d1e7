"""The firmware's C core, compiled for this machine and started; and a virtual skin at the end of a line."""

import threading
from contextlib import contextmanager

import pytest
from tests.emulator.device_core import HostDevice
from tests.emulator.firmware import missing_tools

from eitskin_tools.virtual_skin.pty import PtyPort
from eitskin_tools.virtual_skin.server import SkinServer


@pytest.fixture
def device():
    missing = missing_tools("host")
    if missing:
        pytest.skip(f"the C core needs {', '.join(missing)}: apt-get install build-essential")
    made = HostDevice()
    made.run(1000)
    return made


@contextmanager
def served(made, *player):
    """Serve a virtual device on a pseudo-terminal in a thread, and yield the terminal's path."""
    with PtyPort() as port:
        server = SkinServer(made, port, *player)
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            yield str(port.path)
        finally:
            server.stop()
            thread.join(60.0)
            assert not thread.is_alive()
