"""Who is let in and who is ended: while descriptors are few, while nobody looks, while an answer is waited for."""

import os
import resource
import socket
import struct
import time
from contextlib import closing, suppress
from pathlib import Path

import msgpack
import pytest
import zmq

from eitskin.messaging import control, publish
from eitskin.messaging.admission import connections, door, traffic
from eitskin.messaging.admission.descriptors import connection_at, end, unread
from eitskin.messaging.admission.gate import Gate

from .test_control_answers import Slow

PATIENCE_S = 60.0

MOST_SENT = 500_000_000
"""Bytes within which who sends without end must be ended; within 50 ms, that is, as fast as loopback is."""


def until(true, look=lambda: None):
    end = time.perf_counter() + PATIENCE_S
    while not true():
        assert time.perf_counter() < end
        look()


def packed(body, flags=0):
    return struct.pack(">BQ", flags | 2, len(body)) + body


class Dealer:
    """A control client over TCP that may send anything."""

    def __init__(self, endpoint):
        host, port = endpoint.removeprefix("tcp://").split(":")
        self.stream = socket.create_connection((host, int(port)), PATIENCE_S)
        self.stream.sendall(b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(48))
        self.stream.sendall(b"\x04\x1c\x05READY\x0bSocket-Type\x00\x00\x00\x06DEALER")
        received = b""
        while len(received) < 66 or len(received) < 66 + received[65]:
            came = self.stream.recv(4096)
            assert came, received
            received += came
        assert received[12:16] == b"NULL"

    def ask(self, request):
        self.stream.sendall(packed(b"", 1) + packed(request))

    def close(self):
        self.stream.close()


@pytest.fixture
def tcp_server(monkeypatch, recorder):
    """A control server on TCP without keys, which only a test may have."""
    monkeypatch.setattr(door, "check_allowed", lambda *_, **__: None)
    server = control.ControlServer("tcp://127.0.0.1:*", recorder)
    yield server
    server.close()


def test_a_listener_through_which_somebody_is_coming_just_now_is_not_given_back(tmp_path):
    """Between leaving the queue and having a descriptor it looks as if nobody had come."""
    with zmq.Context() as context, context.socket(zmq.XPUB) as ours, context.socket(zmq.SUB) as client:
        ours.linger = client.linger = 0
        gate = Gate(ours, Path(tmp_path / "f"), 8)
        client.connect(f"ipc://{tmp_path}/f")
        client.subscribe(b"")
        until(lambda: connection_waits(gate))
        assert gate.let_in(8)
        assert ours.poll(60_000)
        (name,) = gate.settled
        gate.forget([name])
        assert gate.ours(name)
        gate.forget([])  # it was seen meanwhile
        gate.forget([name])
        assert gate.ours(name)
        ours.send(b"frame")
        assert client.poll(60_000)
        gate.forget([name])
        assert not gate.ours(name)
        gate.close()


def connection_waits(gate):
    from eitskin.messaging.admission.descriptors import somebody_waits

    return somebody_waits(gate.descriptor)


def test_whose_a_connection_is_can_be_told_without_a_descriptor(tmp_path):
    before, held = resource.getrlimit(resource.RLIMIT_NOFILE), []
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.create_connection(listener.getsockname()) as one:
        other, _ = listener.accept()
        with other:
            found, listening = connection_at(other.fileno()), connection_at(listener.fileno())
            resource.setrlimit(resource.RLIMIT_NOFILE, (max(map(int, os.listdir("/proc/self/fd"))) + 1, before[1]))
            try:
                with suppress(OSError):
                    while True:
                        held.append(os.open("/dev/null", os.O_RDONLY))
                assert connections._own_name(found) == listener.getsockname()[1]
                assert connections._own_name(listening) is None
                assert connections._own_name((found[0], found[1] + 1)) is None
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, before)
                for number in held:
                    os.close(number)
            one.sendall(b"x")
            assert other.recv(1) == b"x"  # nothing was closed by looking


@pytest.mark.parametrize("family", [socket.AF_INET, socket.AF_UNIX])
def test_what_was_sent_before_a_connection_was_ended_is_read_by_nobody(family, tmp_path):
    with socket.socket(family) as listener, socket.socket(family) as flood:
        listener.bind(("127.0.0.1", 0) if family == socket.AF_INET else os.fspath(tmp_path / "s"))
        listener.listen()
        flood.connect(listener.getsockname())
        flood.setblocking(False)
        with listener.accept()[0] as ended:
            with suppress(BlockingIOError):
                while flood.send(bytes(65536)):
                    pass
            until(lambda: unread(ended.fileno()) > 100_000)
            end(connection_at(ended.fileno()))
            with suppress(ConnectionResetError):  # TCP resets who sends what nobody can read any more
                assert not ended.recv(65536)


def test_a_look_lets_libzmq_take_in_more_once_and_not_with_each_message(publisher, monkeypatch):
    with zmq.Context() as context, context.socket(zmq.XSUB) as flood:
        flood.linger = 0
        flood.connect(publisher.endpoint)
        for index in range(15):
            flood.send(b"\x01" + bytes([index]))
        asked = Asked(publisher._socket)
        monkeypatch.setattr(publisher, "_socket", asked)

        def look():
            asked.times = 0
            publisher.look()
            assert asked.times == 1

        until(lambda: len(publisher.topics) == 15, look)


class Asked:
    """A socket that counts how often it is asked whether anything waits."""

    def __init__(self, socket_):
        self._socket, self.times = socket_, 0

    def getsockopt(self, option):
        self.times += option == zmq.EVENTS
        return self._socket.getsockopt(option)

    def __getattr__(self, name):
        return getattr(self._socket, name)


def test_a_crowd_on_tcp_is_ended_while_the_frame_loop_stands_still(monkeypatch):
    monkeypatch.setattr(publish, "MOST_SUBSCRIBERS", 4)
    monkeypatch.setattr(connections, "SPARE", 2)
    monkeypatch.setattr(connections, "GRACE_S", 0.0)
    publisher = publish.Publisher("tcp://127.0.0.1:*")
    port = int(publisher.endpoint.rpartition(":")[2])
    crowd = [socket.create_connection(("127.0.0.1", port)) for _ in range(20)]
    until(lambda: publisher.refused == 14, lambda: time.sleep(0.01))
    publisher.close()
    for one in crowd:
        one.close()


def test_who_waits_for_a_slow_answer_gets_it_whatever_crowd_comes(monkeypatch, tmp_path, recorder):
    monkeypatch.setattr(control, "MOST_CONNECTIONS", 4)
    monkeypatch.setattr(connections, "SPARE", 2)
    monkeypatch.setattr(connections, "GRACE_S", 0.0)
    slow, crowd = Slow(recorder), []
    server = control.ControlServer(f"ipc://{tmp_path}/control", recorder)
    with zmq.Context() as context, context.socket(zmq.REQ) as asking:
        asking.linger = 0
        asking.connect(server.endpoint)
        asking.send(msgpack.packb({"command": "reference", "frames": 9}))
        assert slow.begun.wait(PATIENCE_S)

        def come():
            one = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
            with suppress(BlockingIOError):
                one.connect(f"{tmp_path}/control")
            crowd.append(one)
            time.sleep(0.002)

        until(lambda: server._door.ended >= 8, come)
        slow.release.set()
        assert asking.poll(60_000)
        assert msgpack.unpackb(asking.recv()) == {"ok": True, "frames": 9, "weak_rows": []}
    for one in crowd:
        one.close()
    server.close()


def test_a_control_client_that_sends_parts_without_end_is_ended(tcp_server):
    part, sent = packed(bytes(30_000), 1), 0
    with closing(Dealer(tcp_server.endpoint)) as endless:
        endless.stream.setblocking(False)
        while not tcp_server._door._connections.greedy:  # the other side's window may be shut for good when it ends
            assert sent < MOST_SENT
            with suppress(OSError):
                sent += endless.stream.send(part)
    with closing(Dealer(tcp_server.endpoint)) as honest:
        honest.ask(msgpack.packb({"command": "status"}))
        assert b"frames" in honest.stream.recv(4096)


def test_a_control_client_that_asks_much_is_not_ended(tcp_server, monkeypatch):
    monkeypatch.setattr(traffic, "PER_S", 0.0)
    large = msgpack.packb({"command": "status", "nothing": bytes(30_000)})
    with closing(Dealer(tcp_server.endpoint)) as busy:
        for _ in range(100):  # 3 MB, sixteen times what may be unfinished
            busy.ask(large)
            assert busy.stream.recv(4096)
