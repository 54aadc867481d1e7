"""Signs of life of a skin's process: who gives none is ended by force, and nobody else is."""

import os
import signal
import socket
import subprocess
import sys

import pytest

from eitskin_tools.robot.child import SILENT_S, SignsOfLife

from .conftest import gone


class Heard:
    """A life that is told things, and looked at ten times a second by a clock of its own."""

    def __init__(self, pid):
        self.ear, self.mouth = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.life = SignsOfLife(self.ear, pid)
        self.now_s = 100.0

    def tell(self, line):
        self.mouth.send(line)
        self.life.hear(self.now_s)

    def after(self, seconds):
        """Return {seconds from now: signal} of what is sent in that time."""
        begin_s, sent = self.now_s, {}
        for _ in range(round(seconds * 10)):
            self.now_s += 0.1
            if (number := self.life.look(self.now_s)) is not None:
                sent[round(self.now_s - begin_s, 1)] = number
        return sent


@pytest.fixture
def heard():
    found = Heard(os.getpid())
    yield found
    found.life.close()
    found.mouth.close()


@pytest.mark.process
def test_a_process_that_is_stopped_is_not_blamed_and_one_that_goes_on_is():
    with subprocess.Popen([sys.executable, "-S", "-c", "input()"], stdin=subprocess.PIPE) as child:
        heard = Heard(child.pid)
        heard.tell(b"READY=1")
        child.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, child.pid, os.WSTOPPED)
        assert heard.after(5 * SILENT_S) == {}
        child.send_signal(signal.SIGCONT)
        os.waitid(os.P_PID, child.pid, os.WCONTINUED)
        assert list(heard.after(1.2 * SILENT_S).values())[:1] == [signal.SIGTERM]
        heard.life.close()
        heard.mouth.close()


@pytest.mark.process
def test_one_whose_c_code_keeps_the_interpreter_is_ended_and_started_again(family, tmp_path):
    with family("on-failure", silent_s=1.0, a="hangs", b="good", c="starts") as found:
        found.until(lambda event: event["event"] == "ready" and event.get("skin") == "a")
        before = found.states()
        (tmp_path / "hang").touch()
        warning = found.until(lambda event: event["event"] == "warning")
        assert warning["skin"] == "a"
        assert "no sign of life for 1 s: its frame loop stands still" in warning["text"]
        error = found.until(lambda event: event["event"] == "error")
        assert error["skin"] == "a"
        assert "ended by signal 6 (Aborted): no sign of life for 1 s" in error["text"]
        assert "starts again in 0.05 s" in error["text"]
        shown = [event["text"] for event in found.heard if event["event"] == "warning"]
        assert any("skin_script.py" in line and line.endswith("in hang") for line in shown), shown
        found.until(lambda event: event["event"] == "ready" and event.get("skin") == "a")
        now = found.states()
        assert (now["a"].state, now["a"].restarts) == ("ready", 1)
        assert gone(before["a"].pid)
        assert (now["b"].pid, now["c"].pid) == (before["b"].pid, before["c"].pid)  # one lives, one only starts
        assert (now["b"].restarts, now["c"].restarts) == (0, 0)
