"""Who leaves a verifier does not wait for one that gets no core to end on; where it cannot start, it does so later."""

import errno
import os
import signal
import socket
import subprocess
import sys
import threading

import pytest

from eitskin.messaging.streams.verified import STARTING, WAITING
from eitskin_tools.processes.children import Backoff
from eitskin_tools.verifier.child import Place, VerifierProcess

from .conftest import PATIENCE_S, until

STAYS = (sys.executable, "-c", "import time; time.sleep(600)")


@pytest.mark.process
def test_leaving_does_not_wait_for_a_process_that_does_not_end(monkeypatch):
    killed = []
    monkeypatch.setattr(subprocess.Popen, "kill", lambda process: killed.append(process.pid))
    verifier = VerifierProcess(Place(program=STAYS))
    verifier.__enter__()
    until(lambda: verifier.pid)
    child = verifier.pid
    os.kill(child, signal.SIGSTOP)  # the end of the verifier's thread would end it, if it could
    leaving = threading.Thread(target=verifier.__exit__, args=(None, None, None))
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


@pytest.mark.process
@pytest.mark.parametrize("where", [(os, "memfd_create"), (socket, "socketpair"), (subprocess, "Popen")])
def test_without_descriptors_it_starts_another_time(monkeypatch, where):
    verifier = VerifierProcess(Place(program=STAYS), Backoff(0.1, 0.2, 60.0))

    def none_left(*_, **__):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    with monkeypatch.context() as held:
        held.setattr(*where, none_left)
        verifier.__enter__()
        until(lambda: verifier.state == WAITING)
        assert verifier.why == "the verifier cannot be started: Too many open files; it starts again in 0.1 s"
    try:
        until(lambda: verifier.pid)
        assert (verifier.state, verifier.restarts > 0) == (STARTING, True)
    finally:
        verifier.__exit__()
