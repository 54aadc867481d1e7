"""What the border keeps out, and what nobody behind it can take from others: by mistake, or on purpose."""

import os
import socket
import stat
import subprocess
import sys
import time
from contextlib import ExitStack, closing, suppress

import pytest
import zmq

import eitskin
from eitskin.messaging import control, listener, publish
from eitskin.messaging.curve_keys import load_client_keys, load_server_keys
from eitskin.messaging.frame import EVERY_FRAME

from .publishing import Peer, send, wait_for, wait_until_wanted


def connect(path):
    """Connect and say nothing; None where too many wait."""
    stream = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    with suppress(OSError):
        stream.connect(str(path))
        return stream
    stream.close()
    return None


def test_a_stray_unsubscription_changes_nothing(publisher, packer):
    with eitskin.subscribe(publisher.endpoint, "all", timeout_s=60) as honest, closing(Peer(publisher)) as stranger:
        wait_until_wanted(publisher)
        stranger.send(b"\x00", b"\x00\xde", b"\x00" + EVERY_FRAME, b"\x01seen")
        wait_for(publisher, lambda: b"seen" in publisher.topics)
        assert publisher.topics == {EVERY_FRAME, b"seen"}
        for number in range(1, 11):
            send(publisher, packer, number)
        assert [next(honest).number for _ in range(10)] == list(range(1, 11))
        stranger.close()
        wait_for(publisher, lambda: publisher.topics == {EVERY_FRAME})
    wait_for(publisher, lambda: not publisher.topics)


def test_what_was_taken_back_is_asked_for_until_nobody_is_connected(publisher, monkeypatch):
    monkeypatch.setattr(publish, "DESERTED_S", 0.1)
    with closing(Peer(publisher)) as other:
        with closing(Peer(publisher)) as one:
            one.send(b"\x01" + EVERY_FRAME, b"\x00" + EVERY_FRAME, b"\x01seen")
            wait_for(publisher, lambda: b"seen" in publisher.topics)
            other.send(b"\x01other")
            wait_for(publisher, lambda: b"other" in publisher.topics)
            assert EVERY_FRAME in publisher.topics
        wait_for(publisher, lambda: publisher.topics == {EVERY_FRAME, b"other"})
    wait_for(publisher, lambda: not publisher.topics)
    assert not publisher.wanted


def test_a_flood_of_topics_costs_others_no_frame(publisher, packer):
    with (
        eitskin.subscribe(publisher.endpoint, "all", timeout_s=60) as honest,
        zmq.Context() as context, context.socket(zmq.XSUB) as flood,
    ):  # fmt: skip
        wait_until_wanted(publisher)
        flood.linger = 0
        flood.connect(publisher.endpoint)
        for index in range(5000):
            flood.send(b"\x01" + index.to_bytes(4, "little"))
        number = 0
        while len(publisher.topics) < publish.MOST_TOPICS:
            number += 1
            send(publisher, packer, number)
            assert next(honest).number == number
        assert publisher.wanted
        assert not publisher.takes_short


def test_more_clients_than_are_served_wait_and_come_in_when_one_leaves(tmp_path, packer, monkeypatch):
    monkeypatch.setattr(publish, "MOST_SUBSCRIBERS", 4)
    monkeypatch.setattr(listener, "PAUSE_S", 0.0)
    with ExitStack() as stack:
        publisher = stack.enter_context(closing(publish.Publisher(f"ipc://{tmp_path}/few")))
        honest = stack.enter_context(eitskin.subscribe(publisher.endpoint, "all", timeout_s=60))
        wait_until_wanted(publisher)
        silent = stack.enter_context(ExitStack())
        for number in range(1, 101):
            if (held := connect(tmp_path / "few")) is not None:
                silent.enter_context(held)
            send(publisher, packer, number)
        late = stack.enter_context(eitskin.subscribe(publisher.endpoint, timeout_s=60))
        silent.close()
        wait_until_wanted(publisher)
        send(publisher, packer, 101)
        assert next(late).number == 101
        assert [next(honest).number for _ in range(101)] == list(range(1, 102))
    assert os.listdir(tmp_path) == []


@pytest.mark.process
@pytest.mark.parametrize("asked", ["next(iter(eitskin.subscribe(timeout_s=1)))", "eitskin.request(None, 'status')"])
def test_a_client_with_too_few_files_is_refused_before_libzmq_aborts(asked):
    limit = "import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (9, 9))"
    found = subprocess.run(
        [sys.executable, "-c", f"import eitskin; {limit}; {asked}"], capture_output=True, text=True, check=False
    )
    assert found.returncode == 1
    assert "EndpointError" in found.stderr
    assert "only 9 files may be open" in found.stderr


HELD = """
import resource, sys, time
resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))
from eitskin.messaging.publish import Publisher
publisher = Publisher(f"ipc://{sys.argv[1]}")
number, sent_s = 0, 0.0
print("ready", flush=True)
while True:
    publisher.update()
    if publisher.wanted and time.perf_counter() - sent_s > 0.002:
        number, sent_s = number + 1, time.perf_counter()
        publisher.send(memoryview(b"\\xde\\x00" + number.to_bytes(4, "big") + bytes(6000)))
"""
"""A publisher that may open 256 files, and keeps its thread busy."""


@pytest.mark.process
def test_300_held_connections_at_256_files_end_nobody(tmp_path):
    """libzmq 4.3.5 ends the process whose ipc listener finds no descriptor."""
    with (
        subprocess.Popen([sys.executable, "-c", HELD, tmp_path / "f"], stdout=subprocess.PIPE, text=True) as runtime,
        ExitStack() as stack, zmq.Context() as context, context.socket(zmq.SUB) as good,
    ):  # fmt: skip
        stack.callback(runtime.kill)
        assert runtime.stdout.readline() == "ready\n"
        good.rcvhwm = 0
        good.subscribe(EVERY_FRAME)
        good.connect(f"ipc://{tmp_path}/f")
        assert good.poll(60_000)
        held, end = 0, time.perf_counter() + 1.0
        while held < 300 and (held <= 100 or time.perf_counter() < end):  # where too many wait, nobody else gets in
            if (one := connect(tmp_path / "f")) is not None:
                stack.enter_context(one)
                held += 1
        numbers = []
        while len(numbers) < 200:
            assert good.poll(60_000)
            numbers.append(int.from_bytes(good.recv()[2:6], "big"))
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        assert runtime.poll() is None


def test_who_comes_by_tcp_without_a_key_is_ended_and_who_has_one_loses_nothing(keys, packer, monkeypatch):
    monkeypatch.setattr(publish, "MOST_SUBSCRIBERS", 4)
    trusted = load_client_keys(keys / "server.key", keys / "client.key_secret")
    with ExitStack() as stack:
        publisher = stack.enter_context(closing(publish.Publisher("tcp://127.0.0.1:*", load_server_keys(keys))))
        honest = stack.enter_context(eitskin.subscribe(publisher.endpoint, "all", timeout_s=60, keys=trusted))
        wait_until_wanted(publisher)
        port, number = int(publisher.endpoint.rpartition(":")[2]), 0
        while publisher.refused < 10:
            stack.enter_context(socket.create_connection(("127.0.0.1", port), 60))
            number += 1
            send(publisher, packer, number)
        assert [next(honest).number for _ in range(number)] == list(range(1, number + 1))


@pytest.mark.parametrize("make", [publish.Publisher, control.ControlServer])
def test_a_socket_is_its_owners_alone_whatever_the_umask(tmp_path, recorder, make):
    before = os.umask(0)
    try:
        made = make(f"ipc://{tmp_path}/s", *([recorder] if make is control.ControlServer else []))
    finally:
        os.umask(before)
    with closing(made):
        assert stat.S_IMODE((tmp_path / "s").stat().st_mode) == 0o600
        first = (tmp_path / "s").stat().st_ino
        with connect(tmp_path / "s"):
            while (tmp_path / "s").stat().st_ino == first:  # another listener takes its place
                if make is publish.Publisher:
                    made.update()
        assert stat.S_IMODE((tmp_path / "s").stat().st_mode) == 0o600
