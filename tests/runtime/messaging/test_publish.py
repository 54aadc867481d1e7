import os
import socket
import stat
import time
from contextlib import suppress

import msgpack
import numpy as np
import pytest
import zmq

import eitskin
from eitskin.errors import EndpointError, NoFrame, StaleFrame
from eitskin.messaging import publish
from eitskin.messaging.admission import connections, door
from eitskin.messaging.admission.topics import Topics
from eitskin.messaging.frame import EVERY_FRAME

from .publishing import send, wait_until_wanted


def test_frames_reach_a_subscriber_and_the_publisher_knows_that_it_is_wanted(publisher, packer):
    assert not publisher.wanted
    with eitskin.subscribe(publisher.endpoint, timeout_s=60) as frames:
        wait_until_wanted(publisher)
        send(publisher, packer, 1)
        assert next(frames).number == 1
    end = time.perf_counter() + 60
    while publisher.wanted and time.perf_counter() < end:
        publisher.look()
    assert not publisher.wanted


def test_a_slow_subscriber_sees_the_newest_frame_and_delays_nobody(publisher, packer):
    with (
        eitskin.subscribe(publisher.endpoint, timeout_s=60) as slow,
        eitskin.subscribe(publisher.endpoint, mode="all", timeout_s=60) as recorder,
    ):
        wait_until_wanted(publisher, 2)
        numbers = []
        for number in range(1, 1001):  # all in one thread: a publisher that waited for either would wait for ever
            send(publisher, packer, number)
            if number % 100 == 0:
                time.sleep(0.02)  # the slow one wakes ten times
                while next(slow).number < number:
                    pass  # on a busy machine the newest may need a moment to arrive
            if number % 250 == 0:  # a second's worth and more waits in its queue
                numbers += [next(recorder).number for _ in range(250)]
        assert publisher.dropped == 0
        assert slow.received < 500
        assert slow.received + slow.lost > 800  # what it never saw is counted, from its first frame on
        assert numbers == list(range(1, 1001))
        assert recorder.lost == 0


def test_a_recorder_that_is_too_slow_even_for_its_queue_counts_the_gap(publisher, packer, monkeypatch):
    with eitskin.subscribe(publisher.endpoint, mode="all", timeout_s=60) as recorder:
        wait_until_wanted(publisher)
        number = sent = 5_000
        for early in range(1, sent + 1):
            send(publisher, packer, early)
        while recorder._number <= sent and number < 2 * sent:  # one that comes after the gap tells of it
            number += 1
            send(publisher, packer, number)
            while recorder._socket.poll(50):
                recorder.next_frame()
        assert recorder.lost > 0
        assert recorder.received + recorder.lost == recorder._number


@pytest.mark.parametrize("read", [0, 60, 120, 150, 180])
def test_as_many_frames_wait_as_are_promised_whatever_was_read_before(publisher, packer, read):
    with zmq.Context() as context, context.socket(zmq.SUB) as reader:
        reader.setsockopt(zmq.RCVHWM, 1)  # it is the publisher's queue that is asked for
        reader.setsockopt(zmq.RCVTIMEO, 60_000)
        reader.setsockopt(zmq.SUBSCRIBE, EVERY_FRAME)
        reader.connect(publisher.endpoint)
        wait_until_wanted(publisher)
        for number in range(1, read + 1):
            send(publisher, packer, number)
            reader.recv()
        for number in range(read + 1, read + publish.QUEUE_FRAMES + 1):
            send(publisher, packer, number)
        waited = [msgpack.unpackb(reader.recv())["n"] for _ in range(publish.QUEUE_FRAMES)]
    assert waited == list(range(read + 1, read + publish.QUEUE_FRAMES + 1))


def test_silence_and_old_frames_are_errors_that_are_also_timeouts(publisher, packer):
    with eitskin.subscribe(publisher.endpoint, timeout_s=60, max_age_s=60.5) as frames:
        wait_until_wanted(publisher)
        send(publisher, packer, 1, age_us=700_000_000)
        with pytest.raises(StaleFrame, match=r"7\d\d\.\d{3} s old, expected at most 60.5 s") as caught:
            next(frames)
        assert isinstance(caught.value, TimeoutError)
        send(publisher, packer, 2)
        assert next(frames).number == 2
    with eitskin.subscribe(publisher.endpoint, timeout_s=0.2) as frames, pytest.raises(NoFrame, match=r"within 0\.2 s"):
        next(frames)


@pytest.mark.parametrize(
    "arguments", [{"mode": "newest"}, {"timeout_s": 0}, {"timeout_s": float("nan")}, {"max_age_s": -1.0}]
)
def test_bad_arguments_of_subscribe_name_the_value(arguments):
    with pytest.raises(ValueError, match=str(next(iter(arguments.values())))):
        eitskin.subscribe("ipc:///tmp/none", **arguments)


def test_an_endpoint_that_makes_no_sense_is_refused():
    with pytest.raises(EndpointError, match="skin://here"):
        eitskin.subscribe("skin://here")


def test_a_hostile_publisher_cannot_stop_a_subscriber(tmp_path, packer):
    endpoint = f"ipc://{tmp_path}/hostile"
    rng = np.random.default_rng(0)
    good = bytes(packer.message())
    nan = msgpack.packb(msgpack.unpackb(good) | {"map": np.full(1350, np.nan, "<f4").tobytes()})
    bad = [EVERY_FRAME + rest for rest in (b"", b"\x91" * 3000, b"\xff\xff\xff\xff", bytes(15000))]
    bad += [EVERY_FRAME + rng.integers(0, 256, 100, dtype=np.uint8).tobytes() for _ in range(200)]
    bad += [nan, good[:-1]]
    assert all(message.startswith(EVERY_FRAME) for message in bad)  # else it would not even be received
    with zmq.Context() as context, context.socket(zmq.XPUB) as hostile:
        hostile.bind(endpoint)
        with eitskin.subscribe(endpoint, mode="all", timeout_s=60) as frames:
            assert hostile.poll(60_000)  # it has subscribed
            for message in bad:
                hostile.send(message)
            hostile.send_multipart([good, good])
            hostile.send(good)
            while frames.rejected < len(bad):
                frames.next_frame()
            assert frames.next_frame().solver == "vd2t"
        hostile.close(0)


def test_a_flood_of_subscriptions_ends_whoever_sends_it_and_nobody_else(publisher, packer):
    with eitskin.subscribe(publisher.endpoint, mode="all", timeout_s=60) as honest:
        wait_until_wanted(publisher)
        send(publisher, packer, 1)
        assert next(honest).number == 1
        number = 1
        with zmq.Context() as context, context.socket(zmq.XSUB) as flood:
            flood.linger = 0
            flood.connect(publisher.endpoint)
            for index in range(5000):
                flood.send(b"\x01" + index.to_bytes(4, "little"))
            end = time.perf_counter() + 60
            while not publisher.ended and time.perf_counter() < end:
                number += 1
                send(publisher, packer, number)
        assert publisher.ended >= 1
        assert [next(honest).number for _ in range(number - 1)] == list(range(2, number + 1))
        assert honest.lost == 0


def test_a_topic_is_taken_back_by_nobody_but_who_has_it(publisher, packer):
    with eitskin.subscribe(publisher.endpoint, timeout_s=60), zmq.Context() as context:
        wait_until_wanted(publisher)
        with context.socket(zmq.XSUB) as stranger:
            stranger.linger = 0
            stranger.connect(publisher.endpoint)
            stranger.send(b"\x01mine")
            end = time.perf_counter() + 60
            while b"mine" not in publisher.topics and time.perf_counter() < end:
                publisher.look()
            peer = Peer(publisher)
            peer.send(b"\x00", b"\x00mine", b"\x01seen")
            while b"seen" not in publisher.topics and time.perf_counter() < end:
                publisher.look()
        assert publisher.topics == {EVERY_FRAME: 1, b"mine": 1, b"seen": 1}
        peer.stream.close()
        while len(publisher.topics) > 1 and time.perf_counter() < end:
            publisher.look()
        assert publisher.topics == {EVERY_FRAME: 1}
        assert publisher.wanted


class Peer:
    """Says what libzmq's own clients never say."""

    def __init__(self, publisher):
        self.stream = socket.socket(socket.AF_UNIX)
        self.stream.connect(publisher.endpoint.removeprefix("ipc://"))
        self.stream.sendall(b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(48))
        self.stream.sendall(b"\x04\x19\x05READY\x0bSocket-Type\x00\x00\x00\x03SUB")
        self.stream.setblocking(False)
        received = 0
        while received <= 64:  # until the other side is ready, libzmq takes no message
            publisher.look()
            with suppress(BlockingIOError):
                received += len(self.stream.recv(64))

    def send(self, *bodies):
        self.stream.sendall(b"".join(bytes([0, len(body)]) + body for body in bodies))


def test_whoever_lies_where_a_connection_was_is_not_taken_for_it():
    class Late:
        bytes = b"\x01x"

        def get(self, _):
            return 5

    topics = Topics(lambda descriptor: None)  # something else has that number by now
    topics.take(Late())
    assert topics.all() == {}
    assert not topics.talkative


def test_an_oversized_subscription_never_reaches_the_publisher(publisher):
    with zmq.Context() as context, context.socket(zmq.XSUB) as client:
        client.linger = 0
        with client.get_monitor_socket(zmq.EVENT_DISCONNECTED) as ended:
            client.connect(publisher.endpoint)
            client.send(b"\x01" + bytes(1000))
            end = time.perf_counter() + 20  # below libzmq's own patience of 30 s with who never greets
            while not ended.poll(10):  # it is not read, and who sent it is cut off
                publisher.look()
                assert time.perf_counter() < end
            client.disable_monitor()
        publisher.look()
        assert not publisher.wanted


def test_too_many_strangers_are_ended_and_a_subscriber_stays(tmp_path, packer, monkeypatch):
    monkeypatch.setattr(publish, "MOST_SUBSCRIBERS", 4)
    monkeypatch.setattr(connections, "GRACE_S", 0.0)
    publisher = publish.Publisher(f"ipc://{tmp_path}/few")
    clients = []
    try:
        with eitskin.subscribe(publisher.endpoint, mode="all", timeout_s=60) as honest:
            wait_until_wanted(publisher)
            number, end = 0, time.perf_counter() + 60
            while not publisher.refused and time.perf_counter() < end:
                client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
                with suppress(BlockingIOError):
                    client.connect(f"{tmp_path}/few")
                clients.append(client)
                number += 1
                send(publisher, packer, number)
            assert publisher.refused
            assert [next(honest).number for _ in range(number)] == list(range(1, number + 1))
    finally:
        for client in clients:
            client.close()
        publisher.close()
    assert os.listdir(tmp_path) == []


def test_a_socket_is_its_owners_alone_whatever_the_umask(tmp_path):
    before = os.umask(0)
    try:
        publisher = publish.Publisher(f"ipc://{tmp_path}/frames")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "frames").stat().st_mode) == 0o600
    publisher.close()


def test_so_few_files_that_nobody_could_come_are_refused_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(door, "room", lambda: 3)
    with pytest.raises(
        EndpointError, match=r"3 are left for connections, expected at least 4: allow more with 'ulimit"
    ):
        publish.Publisher(f"ipc://{tmp_path}/frames")
    assert os.listdir(tmp_path) == []
