"""What a subscriber that has left said last, and who has come meanwhile and lies where it lay."""

import os
import socket
import time
from contextlib import closing, suppress

import pytest

from eitskin.messaging import publish
from eitskin.messaging.admission.topics import MOST_TOPICS, Topics
from eitskin.messaging.frame import EVERY_FRAME

PATIENCE_S = 60.0
GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(48)
READY = b"\x04\x19\x05READY\x0bSocket-Type\x00\x00\x00\x03SUB"


@pytest.fixture
def publisher():
    with closing(publish.Publisher("tcp://127.0.0.1:*")) as found:
        yield found


class Raw:
    """Greets and subscribes as it likes."""

    def __init__(self, publisher):
        host, _, port = publisher.endpoint.removeprefix("tcp://").rpartition(":")
        self.stream = socket.create_connection((host, int(port)), PATIENCE_S)
        self.stream.sendall(GREETING + READY)
        self.stream.setblocking(False)
        self.came = b""

    def hears(self, what):
        """Whether it was told so by now; raises ConnectionResetError if it was ended."""
        with suppress(BlockingIOError):
            came = self.stream.recv(65536)
            if not came:
                raise ConnectionResetError("ended")
            self.came += came
        return what in self.came

    def close(self):
        self.stream.close()

    def subscribe(self, *topics):
        self.stream.sendall(b"".join(bytes([0, 1 + len(topic), 1]) + topic for topic in topics))


def until(true, meanwhile=lambda: None):
    end = time.perf_counter() + PATIENCE_S
    while not true():
        meanwhile()
        assert time.perf_counter() < end


def connections():
    """Descriptors of connections of this process, whatever they lead to."""
    found = set()
    for name in os.listdir("/proc/self/fd"):
        with suppress(OSError):
            if os.readlink(f"/proc/self/fd/{name}").startswith("socket:"):
                found.add(int(name))
    return found


def test_who_comes_is_not_taken_for_who_has_just_left(publisher):
    first = Raw(publisher)
    until(lambda: first.hears(b"READY"), publisher.look)
    before = connections()
    first.subscribe(*(bytes([number]) * 9 for number in range(1, 101)))
    first.close()
    # What is sent has libzmq take in what waits, and nobody looks at it yet.
    until(lambda: len(connections()) <= len(before) - 2, lambda: publisher.send_beside(b"nobody's"))
    gone = before - connections()
    with closing(Raw(publisher)) as second:
        until(lambda: second.hears(b"READY"), lambda: publisher.send_beside(b"nobody's"))
        assert gone & connections(), "the test needs that a number is used again"
        second.subscribe(EVERY_FRAME)
        until(lambda: EVERY_FRAME in publisher.topics, publisher.look)
        publisher.send_beside(EVERY_FRAME + b"mine")
        until(lambda: second.hears(EVERY_FRAME + b"mine"))
        assert publisher.topics[EVERY_FRAME] == 1
        assert publisher.ended == 0


def test_who_asks_for_much_itself_is_ended(publisher):
    with closing(Raw(publisher)) as greedy:
        until(lambda: greedy.hears(b"READY"), publisher.look)
        greedy.subscribe(*(bytes([number]) * 45 for number in range(1, 101)))
        until(lambda: publisher.ended, publisher.look)
        with pytest.raises(ConnectionResetError):
            until(lambda: greedy.hears(b"nothing more"), publisher.look)


def test_of_too_many_topics_the_newest_count():
    class Asked:
        def __init__(self, number):
            self.bytes = b"\x01" + bytes([number])

        def get(self, _):
            return 5

    topics = Topics(lambda descriptor: (descriptor, 1))
    for number in range(100):
        topics.take(Asked(number))
    assert topics.talkative == {(5, 1)}
    assert set(topics.all()) == {bytes([number]) for number in range(100 - MOST_TOPICS, 100)}
