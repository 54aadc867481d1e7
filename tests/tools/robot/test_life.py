"""Signs of life of a skin's process: who gives none is ended by force, and nobody else is."""

import os
import signal
import socket
import subprocess
import sys

import pytest

from eitskin_tools.processes import own_time
from eitskin_tools.robot import life
from eitskin_tools.robot.life import ENDING_S, OVERDUE, PAUSE_S, Life

from .conftest import gone

SILENT_S = 5.0


class Spent:
    """In the place of what the kernel counts: how much of the time a process has to itself."""

    share = 1.0

    def __init__(self, pid, now_s):
        self.looked_s = now_s

    def since_last(self, now_s):
        elapsed_s, self.looked_s = now_s - self.looked_s, now_s
        return self.share * elapsed_s


class Heard:
    """A life that is told things, and looked at ten times a second by a clock of its own."""

    def __init__(self):
        self.ear, self.mouth = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.life = Life(self.ear, 1, SILENT_S)
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
def heard(monkeypatch):
    monkeypatch.setattr(life, "OwnTime", Spent)
    monkeypatch.setattr(Spent, "share", 1.0)
    found = Heard()
    yield found
    found.life.close()
    found.mouth.close()


def test_starting_takes_as_long_as_it_takes(heard):
    heard.tell(b"WATCHDOG=1")  # while a reference is captured
    assert heard.after(1000.0) == {}
    assert heard.life.due_s is None


def test_who_is_ready_and_gives_signs_lives(heard):
    heard.tell(b"READY=1")
    for _ in range(100):
        assert heard.after(0.9 * SILENT_S) == {}
        heard.tell(b"WATCHDOG=1")
    assert not heard.life.forced


def test_who_gives_none_is_ended_by_stronger_and_stronger_signals(heard):
    heard.tell(b"READY=1")
    sent = heard.after(SILENT_S + 5 * PAUSE_S)
    assert list(sent.values())[:4] == [signal.SIGTERM, signal.SIGABRT, signal.SIGKILL, signal.SIGKILL]
    assert SILENT_S < next(iter(sent)) <= SILENT_S * 1.2
    assert heard.life.forced
    assert heard.life.why.startswith("no sign of life for 5 s: its frame loop stands still")


def test_time_in_the_queue_for_a_core_is_not_silence(heard):
    heard.tell(b"READY=1")
    Spent.share = 1 / 15  # thirty programs on two cores
    assert heard.after(OVERDUE * SILENT_S + 14 * (1 - OVERDUE) * SILENT_S) == {}
    assert list(heard.after(2 * SILENT_S).values())[:1] == [signal.SIGTERM]  # it stands still all the same


def test_who_is_stopped_is_not_blamed_however_long(heard):
    heard.tell(b"READY=1")
    Spent.share = 0.0
    assert heard.after(100 * SILENT_S) == {}


def test_who_looked_at_nothing_for_long_counts_one_look(heard):
    heard.tell(b"READY=1")
    assert heard.after(OVERDUE * SILENT_S + 0.2) == {}
    heard.now_s += 1000.0
    assert heard.after(0.1) == {}
    heard.tell(b"WATCHDOG=1")
    assert heard.after(0.9 * SILENT_S) == {}


def test_a_sign_that_comes_after_all_ends_the_force(heard):
    heard.tell(b"READY=1")
    assert list(heard.after(SILENT_S + 0.9).values()) == [signal.SIGTERM]
    heard.tell(b"STOPPING=1")  # it woke, and does as it was told
    assert heard.after(ENDING_S) == {}
    assert list(heard.after(2.0).values())[:1] == [signal.SIGTERM]
    assert "for 8 s: its end stands still" in heard.life.why


def test_what_is_no_sign_is_none(heard):
    heard.tell(b"STATUS=ready")
    heard.tell(b"")
    heard.tell(bytes(5000))
    assert heard.life.due_s is None


def thread(state="S", ran_ns=1, queued_ns=1):
    return own_time.Thread(state, ran_ns, queued_ns)


@pytest.mark.parametrize(("before", "now", "own_s"), [
    ({"7": thread()}, {"7": thread()}, 2.0),  # it waits for something
    ({"7": thread("R")}, {"7": thread("R", ran_ns=2_000_000_000)}, 2.0),  # it computes
    ({"7": thread()}, {"7": thread(queued_ns=1_500_000_001)}, 0.5),
    ({"7": thread("R")}, {"7": thread("R")}, 0.0),  # it has been in the queue all along
    ({"7": thread(), "8": thread()}, {"7": thread(), "8": thread(queued_ns=1_900_000_001)}, 0.1),
    ({"7": thread()}, {"7": thread(), "9": thread(queued_ns=10**12)}, 2.0),  # one that is new
    ({"7": thread()}, {"7": thread("T")}, 0.0), ({"7": thread()}, {"7": thread("t")}, 0.0),
    ({"7": thread()}, {}, 0.0),  # it is gone
    ({"7": thread("R", 0, 0)}, {"7": thread("R", 0, 0)}, 2.0),  # a kernel that does not count
])  # fmt: skip
def test_own_time_is_what_is_left_of_waiting_for_a_core(before, now, own_s, tmp_path):
    def write(threads):
        for name, one in threads.items():
            (tmp_path / "7" / "task" / name).mkdir(parents=True, exist_ok=True)
            (tmp_path / "7" / "task" / name / "stat").write_text(f"{name} (a) R 1) {one.state} 1 2 3")
            if one.ran_ns or one.queued_ns:
                (tmp_path / "7" / "task" / name / "schedstat").write_text(f"{one.ran_ns} {one.queued_ns} 1\n")

    write(before)
    found = own_time.OwnTime(7, 10.0, tmp_path)
    if not now:
        (tmp_path / "7").rename(tmp_path / "gone")
    write(now)
    assert found.since_last(12.0) == pytest.approx(own_s)


@pytest.mark.process
def test_the_kernel_says_who_is_stopped_who_waits_and_who_is_gone():
    with subprocess.Popen([sys.executable, "-S", "-c", "input()"], stdin=subprocess.PIPE) as child:
        found = own_time.OwnTime(child.pid, 0.0)
        child.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, child.pid, os.WSTOPPED)
        assert found.since_last(1000.0) == 0.0
        child.send_signal(signal.SIGCONT)
        os.waitid(os.P_PID, child.pid, os.WCONTINUED)
        assert 900.0 < found.since_last(2000.0) <= 1000.0
        child.kill()
        child.wait()
        assert found.since_last(3000.0) == 0.0


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


@pytest.mark.process
def test_one_that_was_stopped_meanwhile_is_left_alone(family, tmp_path):
    with family("on-failure", silent_s=1.0, a="hangs", b="good") as found:
        found.ready()
        before = found.states()["b"]
        os.kill(before.pid, signal.SIGSTOP)
        (tmp_path / "hang").touch()
        found.until(lambda event: event["event"] == "error")  # as long as b was silent as well
        os.kill(before.pid, signal.SIGCONT)
        found.until(lambda event: event["event"] == "ready" and event.get("skin") == "a")
        assert found.states()["b"] == before


@pytest.mark.process
def test_where_no_new_start_is_asked_for_it_has_failed(family, tmp_path):
    with family(silent_s=0.5, a="hangs") as found:
        found.ready()
        (tmp_path / "hang").touch()
        assert found.ended() == 1
        assert "no sign of life for 0.5 s" in found.heard[-1]["text"]
