"""Who leaves a verifier does not wait for one that gets no core to end on."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from eitskin_tools.verifier.keeper import Keeper, Place

from .conftest import PATIENCE_S, until

STAYS = (sys.executable, "-c", "import time; time.sleep(600)")


@pytest.mark.process
def test_leaving_does_not_wait_for_a_process_that_does_not_end(monkeypatch):
    killed = []
    monkeypatch.setattr(subprocess.Popen, "kill", lambda process: killed.append(process.pid))
    keeper = Keeper(Place(program=STAYS))
    keeper.__enter__()
    until(lambda: keeper.pid)
    child = keeper.pid
    os.kill(child, signal.SIGSTOP)  # the end of the keeper's thread would end it, if it could
    leaving = threading.Thread(target=keeper.__exit__, args=(None, None, None))
    leaving.start()
    try:
        leaving.join(PATIENCE_S)
        assert not leaving.is_alive()
        assert killed == [child]
    finally:
        os.kill(child, signal.SIGKILL)
        leaving.join(PATIENCE_S)
        for thread in threading.enumerate():
            if thread.name == "verifier-leaves":
                thread.join(PATIENCE_S)
