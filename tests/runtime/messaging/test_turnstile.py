"""Who comes to a TCP address without keys waits until the loop has seen to those before him."""

import socket
import time
from contextlib import closing

import pytest

import eitskin
from eitskin.messaging import publish
from eitskin.messaging.admission import turnstile

PATIENCE_S = 60.0
GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(48)
READY = b"\x04\x19\x05READY\x0bSocket-Type\x00\x00\x00\x03SUB"
GREETING_2 = b"\xff" + bytes(7) + b"\x01\x7f\x01\x02\x00\x00"
"""Of ZMTP 2.0, which knows no handshake: a revision, SUB, no identity."""


class Newcomer:
    """Greets, and says no more until it is told to."""

    def __init__(self, publisher, first=GREETING + READY):
        host, port = publisher.endpoint.removeprefix("tcp://").split(":")
        self.stream = socket.create_connection((host, int(port)), PATIENCE_S)
        self.stream.sendall(first)
        self.came = b""

    def let_in(self):
        """Whether it was told to be ready by now; raises ConnectionError if it was ended."""
        self.stream.setblocking(False)
        try:
            came = self.stream.recv(4096)
        except BlockingIOError:
            return False
        if not came:
            raise ConnectionResetError("ended")
        self.came += came
        return b"READY" in self.came

    def close(self):
        self.stream.close()


@pytest.fixture
def one_at_a_time(monkeypatch):
    monkeypatch.setattr(turnstile, "FIRST", 1)
    monkeypatch.setattr(turnstile, "BATCH", 1)


@pytest.fixture
def publisher(one_at_a_time):
    with closing(publish.Publisher("tcp://127.0.0.1:*")) as found:
        yield found


def until(true):
    end = time.perf_counter() + PATIENCE_S
    while not true():
        assert time.perf_counter() < end


def test_the_second_waits_for_a_calm_look(publisher):
    with closing(Newcomer(publisher)) as first, closing(Newcomer(publisher)) as second:
        until(lambda: publisher._turnstile._wanting)
        until(lambda: first.let_in() or second.let_in())
        waits = second if b"READY" in first.came else first
        assert not waits.let_in()
        publisher.look()
        until(waits.let_in)


def test_a_look_that_finds_something_to_do_lets_nobody_in(publisher, monkeypatch):
    monkeypatch.setattr(publish, "CALM", 0)
    with closing(Newcomer(publisher)) as first:
        until(first.let_in)
        first.stream.sendall(b"".join(b"\x00\x02\x01" + bytes([number]) for number in range(3)))
        with closing(Newcomer(publisher)) as second:
            until(lambda: publisher._turnstile._wanting)
            calm = 0
            while len(publisher.topics) < 3:  # as libzmq hands them on
                taken = len(publisher.topics)
                publisher.look()
                calm += len(publisher.topics) == taken
                assert publisher._turnstile._calm == calm
            publisher.look()
            assert publisher._turnstile._calm == calm + 1
            until(second.let_in)


def test_who_was_not_let_in_has_no_topic_whatever_it_sends(publisher):
    """A client that does not wait for an answer, or speaks a ZMTP without handshakes, is ended."""
    for first in (GREETING + READY + b"\x00\x01\x01" * 50, GREETING_2 + b"\x00\x01\x01"):
        with closing(Newcomer(publisher, first)) as hasty, pytest.raises(ConnectionError):
            until(hasty.let_in)
    publisher.look()
    assert not publisher.topics
    assert not publisher.wanted


def test_a_crowd_is_let_in_by_and_by(publisher):
    crowd = [Newcomer(publisher) for _ in range(40)]
    waiting = set(crowd)

    def all_in():
        publisher.look()
        waiting.difference_update([one for one in waiting if one.let_in()])
        return not waiting

    until(all_in)
    for one in crowd:
        one.close()


def test_a_publisher_ends_while_somebody_waits(one_at_a_time):
    publisher = publish.Publisher("tcp://127.0.0.1:*")
    with closing(Newcomer(publisher)), closing(Newcomer(publisher)):
        until(lambda: publisher._turnstile._wanting)
        publisher.close()


def test_at_an_ipc_address_too_a_look_that_finds_much_to_do_lets_nobody_in(tmp_path, monkeypatch):
    with (
        closing(publish.Publisher(f"ipc://{tmp_path}/f")) as publisher,
        eitskin.subscribe(publisher.endpoint, timeout_s=PATIENCE_S),
    ):
        until(lambda: publisher._door._poll.poll(0))  # somebody waits
        monkeypatch.setattr(publish, "CALM", -1)
        for _ in range(20):
            publisher.look()
        assert publisher._door._poll.poll(0)
        monkeypatch.undo()
        until(lambda: publisher.look() or publisher.topics)
