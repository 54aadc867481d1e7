import contextlib
import os
import stat
import time

import msgpack
import numpy as np
import pytest
import zmq

import eitskin
from eitskin.errors import EndpointError, NoFrame, StaleFrame
from eitskin.messaging import publish
from eitskin.messaging.curve_keys import ServerKeys, load_client_keys, load_server_keys, make_keys
from eitskin.messaging.endpoints import needs_keys
from eitskin.messaging.frame_packer import FramePacker
from eitskin.messaging.publish import Publisher


@pytest.fixture
def packer():
    packer = FramePacker(configuration="paper/1", bundle="b", serial_number="s", run="r")
    packer.put_texts("vd2t", (), ())
    return packer


def send(publisher, packer, number, age_us=100):
    packer.put("n", number)
    packer.put("seq", number)
    packer.put("age_us", age_us)
    packer.put("publish", time.perf_counter_ns())
    publisher.look()
    publisher.send(packer.message())


def wait_until_wanted(publisher):
    end = time.perf_counter() + 60
    while not publisher.wanted and time.perf_counter() < end:
        publisher.look()
        time.sleep(0.005)
    assert publisher.wanted


@pytest.fixture
def publisher(tmp_path):
    publisher = Publisher(f"ipc://{tmp_path}/frames")
    yield publisher
    publisher.close()


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
        wait_until_wanted(publisher)
        time.sleep(0.1)  # the second subscriber joins as well
        longest = 0.0
        for number in range(1, 1001):
            start = time.perf_counter()
            send(publisher, packer, number)
            longest = max(longest, time.perf_counter() - start)
            if number % 100 == 0:
                time.sleep(0.02)  # the slow one wakes ten times
                while next(slow).number < number:
                    pass  # on a busy machine the newest may need a moment to arrive
        assert longest < 5.0  # two seconds' worth of frames wait in its queue; the publisher does not
        assert slow.received < 200
        assert slow.received + slow.lost > 800  # what it never saw is counted, from its first frame on
        numbers = [next(recorder).number for _ in range(1000)]
        assert numbers == list(range(1, 1001))
        assert recorder.lost == 0


def test_a_recorder_that_is_too_slow_even_for_its_queue_counts_the_gap(publisher, packer, monkeypatch):
    with eitskin.subscribe(publisher.endpoint, mode="all", timeout_s=5) as recorder:
        wait_until_wanted(publisher)
        sent = 5_000
        for number in range(1, sent + 1):
            send(publisher, packer, number)
        time.sleep(0.2)
        send(publisher, packer, sent + 1)
        with contextlib.suppress(NoFrame):
            while True:
                recorder.next_frame()
        if recorder._number <= sent:  # the queues were full to the end; one more tells the gap
            send(publisher, packer, sent + 2)
            recorder.next_frame()
        assert recorder.lost > 0
        assert recorder.received + recorder.lost == recorder._number


def test_silence_and_old_frames_are_errors_that_are_also_timeouts(publisher, packer):
    with eitskin.subscribe(publisher.endpoint, timeout_s=0.2, max_age_s=0.5) as frames:
        with pytest.raises(NoFrame, match=r"within 0\.2 s"):
            next(frames)
        wait_until_wanted(publisher)
        send(publisher, packer, 1, age_us=700_000)
        with pytest.raises(StaleFrame, match=r"0\.7\d\d s old, expected at most 0.5 s") as caught:
            next(frames)
        assert isinstance(caught.value, TimeoutError)
        send(publisher, packer, 2)
        assert next(frames).number == 2


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
    bad = [b"", b"\x91" * 3000, b"\xdf\xff\xff\xff\xff", nan, good[:-1], bytes(15000)]
    bad += [rng.integers(0, 256, 100, dtype=np.uint8).tobytes() for _ in range(200)]
    with zmq.Context() as context, context.socket(zmq.PUB) as hostile:
        hostile.bind(endpoint)
        with eitskin.subscribe(endpoint, mode="all", timeout_s=60) as frames:
            time.sleep(0.3)
            for message in bad:
                hostile.send(message)
            hostile.send_multipart([good, good])
            hostile.send(good)
            while frames.rejected < len(bad):
                frames.next_frame()
            assert frames.next_frame().solver == "vd2t"
        hostile.close(0)


def test_an_address_in_use_is_named_and_its_owner_is_not_disturbed(publisher, packer):
    with pytest.raises(EndpointError, match=r"frames is in use: stop the program"):
        Publisher(publisher.endpoint)
    with eitskin.subscribe(publisher.endpoint, timeout_s=60) as frames:
        wait_until_wanted(publisher)
        send(publisher, packer, 4)
        assert next(frames).number == 4
    first = Publisher("tcp://127.0.0.1:*")
    assert first.endpoint.startswith("tcp://127.0.0.1:")
    with pytest.raises(EndpointError, match="is in use"):
        Publisher(first.endpoint)
    first.close()


def test_a_dead_socket_is_taken_over_and_any_other_file_is_left_alone(tmp_path):
    import socket

    path = tmp_path / "frames"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    publisher = Publisher(f"ipc://{path}")
    assert stat.S_ISSOCK(path.stat().st_mode)
    publisher.close()
    publisher.close()
    assert not path.exists()
    path.write_text("precious")
    with pytest.raises(EndpointError, match="no socket is in the way"):
        Publisher(f"ipc://{path}")
    assert path.read_text() == "precious"
    with pytest.raises(EndpointError, match="folder does not exist"):
        Publisher(f"ipc://{tmp_path}/none/frames")


@pytest.mark.parametrize("endpoint", ["tcp://0.0.0.0:5555", "tcp://*:5555", "tcp://192.0.2.1:5555", "tcp://eth0:5555"])
def test_tcp_beyond_this_machine_is_refused_without_keys(endpoint):
    with pytest.raises(EndpointError, match=r"--curve-keys DIR.*doctor --make-curve-keys"):
        Publisher(endpoint)


def test_which_endpoints_need_keys():
    assert not needs_keys("ipc:///tmp/x", control=True)
    assert not needs_keys("tcp://127.0.0.1:5555", control=False)
    assert not needs_keys("tcp://[::1]:5555", control=False)
    assert needs_keys("tcp://127.0.0.1:5555", control=True)
    assert needs_keys("tcp://10.0.0.1:5555", control=False)
    assert needs_keys("tcp://localhost:5555", control=False)  # a name may be made to point anywhere


@pytest.mark.parametrize(
    "endpoint",
    ["", "frames", "inproc://x", "udp://1.2.3.4:5", "ipc://@abstract", "ipc://relative", "tcp://127.0.0.1",
     "tcp://127.0.0.1:99999", "tcp://:5", "ipc:///" + "x" * 200],
)  # fmt: skip
def test_other_endpoints_are_refused(endpoint):
    with pytest.raises(EndpointError):
        Publisher(endpoint)


@pytest.fixture
def keys(tmp_path):
    make_keys(tmp_path / "keys")
    return tmp_path / "keys"


def test_curve_lets_in_who_is_listed_and_nobody_else(tmp_path, keys, packer):
    make_keys(tmp_path / "stranger")
    publisher = Publisher("tcp://127.0.0.1:*", load_server_keys(keys))
    trusted = load_client_keys(keys / "server.key", keys / "client.key_secret")
    stranger = load_client_keys(keys / "server.key", tmp_path / "stranger" / "client.key_secret")
    try:
        with (
            eitskin.subscribe(publisher.endpoint, keys=trusted, timeout_s=60) as frames,
            eitskin.subscribe(publisher.endpoint, keys=stranger, timeout_s=0.3) as nothing,
            eitskin.subscribe(publisher.endpoint, timeout_s=0.3) as plain,
        ):
            wait_until_wanted(publisher)
            time.sleep(0.2)
            send(publisher, packer, 9)
            assert next(frames).number == 9
            for outsider in (nothing, plain):
                with pytest.raises(NoFrame):
                    next(outsider)
    finally:
        publisher.close()


def test_keys_that_others_can_read_or_that_admit_nobody_are_refused(keys):
    assert stat.S_IMODE((keys / "server.key_secret").stat().st_mode) == 0o600
    with pytest.raises(EndpointError, match="holds keys already"):
        make_keys(keys)
    (keys / "server.key_secret").chmod(0o644)
    with pytest.raises(EndpointError, match="chmod 600"):
        load_server_keys(keys)
    (keys / "server.key_secret").chmod(0o600)
    assert isinstance(load_server_keys(keys), ServerKeys)
    (keys / "clients" / "client.key").unlink()
    with pytest.raises(EndpointError, match="nobody could connect"):
        load_server_keys(keys)
    with pytest.raises(EndpointError, match="no CURVE key"):
        load_server_keys(keys / "clients")


def test_a_flood_of_subscriptions_is_cut_off_and_honest_subscribers_return(publisher, packer):
    with eitskin.subscribe(publisher.endpoint, timeout_s=60) as honest:
        wait_until_wanted(publisher)
        with zmq.Context() as context, context.socket(zmq.XSUB) as flood:
            flood.linger = 0
            flood.connect(publisher.endpoint)
            for index in range(5000):
                flood.send(b"\x01" + index.to_bytes(4, "little"))
            end = time.perf_counter() + 60
            while not publisher.resets and time.perf_counter() < end:
                publisher.look()
                time.sleep(0.001)
        assert publisher.resets >= 1
        end = time.perf_counter() + 60
        while honest.received == 0 and time.perf_counter() < end:
            send(publisher, packer, 5)
            if honest._socket.poll(20):
                honest.next_frame()
        assert honest.received == 1


def test_an_oversized_subscription_never_reaches_the_publisher(publisher):
    with zmq.Context() as context, context.socket(zmq.XSUB) as client:
        client.linger = 0
        client.connect(publisher.endpoint)
        client.send(b"\x01" + bytes(1000))
        time.sleep(0.2)
        publisher.look()
        assert not publisher.wanted


def test_too_many_connections_are_cut_off(publisher, monkeypatch):
    import socket

    monkeypatch.setattr(publish, "MOST_CONNECTIONS", 20)
    path = publisher.endpoint.removeprefix("ipc://")
    clients = []
    for _ in range(30):
        client = socket.socket(socket.AF_UNIX)
        client.connect(path)
        clients.append(client)
    end = time.perf_counter() + 60
    while not publisher.resets and time.perf_counter() < end:
        publisher.look_at_connections()
        time.sleep(0.01)
    for client in clients:
        client.close()
    assert publisher.resets == 1
    assert os.path.exists(path)
