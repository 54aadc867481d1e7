import threading

import pytest

from eitskin_tools.service.supervisor import Supervisor
from eitskin_tools.service.watchdog import EXIT_STATUS, LIMIT_S, POLL_S, Watchdog, WatchedLine


class Line:
    """A line whose reads take as long as they are let."""

    name, line_bytes_per_s = "line", 0

    def __init__(self):
        self.let, self.reading = threading.Event(), threading.Event()

    def read(self, timeout_s=None):
        self.reading.set()
        assert self.let.wait(60)
        return b"frame"

    def write(self, data):
        self.written = data


class Heard(Supervisor):
    """A supervisor that counts signs of life."""

    def __init__(self, interval_s=None):
        super().__init__()
        self.interval_s, self.signs = interval_s, 0

    def alive(self):
        self.signs += 1


@pytest.fixture
def ended():
    """Return what was said and with which status it ended."""
    return []


@pytest.fixture
def make(ended):
    """Return a maker of watchdogs that are looked with by hand."""

    def make(interval_s=None):
        supervisor = Heard(interval_s)
        dog = Watchdog(lambda text, stacks: ended.append((text, stacks)), supervisor, ended.append)
        return dog, supervisor

    return make


LOOKS = round(LIMIT_S / POLL_S)


def test_a_loop_without_a_beat_ends_the_process_with_the_reason_and_what_it_does(make, ended, tmp_path):
    dog, _ = make()
    socket = tmp_path / "frames"
    socket.touch()
    dog.sockets.append(socket)
    dog.watch("the frame loop", WatchedLine(Line()))
    for _ in range(LOOKS + 1):
        dog.check()
    assert ended == []
    dog.check()
    (text, stacks), status = ended
    assert text.startswith("the frame loop has stood still for 2 s; ")
    assert "test_a_loop_without_a_beat" in stacks
    assert status == EXIT_STATUS
    assert not socket.exists()


def test_waiting_for_a_silent_device_is_not_standing_still_and_is_a_sign_of_life(make, ended):
    dog, supervisor = make(interval_s=2.0)
    line = Line()
    watched = WatchedLine(line)
    waiting = threading.Thread(target=watched.read)
    waiting.start()
    assert line.reading.wait(60)
    dog.watch("the frame loop", watched)
    for _ in range(10 * LOOKS):
        dog.check()
    assert supervisor.signs == 10 * LOOKS * POLL_S / 1.0  # one in half of the interval
    line.let.set()
    waiting.join()
    assert ended == []


def test_what_must_end_ends_the_process_if_it_does_not(make, ended):
    dog, _ = make()
    dog.watch("closing everything", limit_s=1.0)
    for _ in range(round(1.0 / POLL_S)):
        dog.check()
    assert ended == []
    dog.check()
    assert ended[0][0].startswith("closing everything has stood still for 1 s")
