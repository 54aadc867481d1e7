import time

import msgpack
import pytest
import zmq

import eitskin
from eitskin.errors import ControlError, EndpointError
from eitskin.messaging import control
from eitskin.messaging.control import ControlServer
from eitskin.messaging.control_client import request
from eitskin.messaging.control_commands import LARGEST_REQUEST
from eitskin.messaging.curve_keys import load_client_keys, load_server_keys, make_keys
from eitskin.messaging.frame import unpack_frame
from eitskin_proto.skin.cloud import flat_cloud


def test_commands_are_answered(server, recorder):
    assert request(server.endpoint, "status") == {"frames": 5}
    assert request(server.endpoint, "reference", frames=7)["frames"] == 7
    assert not recorder.forced
    request(server.endpoint, "reference", frames=7, force=True)
    assert recorder.forced
    request(server.endpoint, "exclude", electrodes=[3, 4])
    assert recorder.excluded == (3, 4)
    request(server.endpoint, "stop")
    assert recorder.stopped


def test_the_clock_of_a_runtime_on_this_machine_is_its_own_within_the_stated_error(server, packer):
    clock = eitskin.measure_clock(server.endpoint)
    assert abs(clock.offset_ns) <= clock.error_ns
    packer.put("publish", time.perf_counter_ns() - 10**9)
    frame = unpack_frame(bytes(packer.message()), 0)
    before, age, after = frame.age_s, clock.age_s(frame), frame.age_s
    assert before - 1e-9 * clock.error_ns <= age <= after + 1e-9 * clock.error_ns


@pytest.mark.parametrize(
    "fields",
    [
        {}, {"command": 5}, {"command": "exec"}, {"command": "__class__"}, {"command": "cloud"},
        {"command": "cloud", "cloud": "text"}, {"command": "cloud", "cloud": b"short"},
        {"command": "cloud", "cloud": []},
        {"command": "cloud", "cloud": bytes(16200), "predicted": bytes(5)}, {"command": "reference", "frames": 1},
        {"command": "reference", "frames": 10**9}, {"command": "reference", "frames": True},
        {"command": "reference", "frames": "7"}, {"command": "reference", "force": 1},
    ],
)  # fmt: skip
def test_requests_that_make_no_sense_are_answered_with_what_is_wrong(server, raw, recorder, fields):
    answer = raw(msgpack.packb(fields))
    assert answer["ok"] is False
    assert answer["error"]
    assert recorder.clouds == []
    assert raw(msgpack.packb({"command": "status"}))["ok"] is True


def test_a_message_over_the_limit_takes_no_memory_and_no_answer(server, raw):
    assert raw(bytes(LARGEST_REQUEST - 100))["ok"] is False
    context = zmq.Context()
    socket = context.socket(zmq.REQ)
    socket.linger = 0
    socket.connect(server.endpoint)
    socket.send(bytes(LARGEST_REQUEST + 1))
    assert not socket.poll(300)
    context.destroy(0)
    assert raw(msgpack.packb({"command": "status"}))["ok"] is True


def test_tcp_control_needs_keys_even_on_loopback(recorder, tmp_path):
    with pytest.raises(EndpointError, match="--curve-keys"):
        ControlServer("tcp://127.0.0.1:*", recorder)
    make_keys(tmp_path / "k")
    make_keys(tmp_path / "other")
    server = ControlServer("tcp://127.0.0.1:*", recorder, load_server_keys(tmp_path / "k"))
    try:
        trusted = load_client_keys(tmp_path / "k/server.key", tmp_path / "k/client.key_secret")
        stranger = load_client_keys(tmp_path / "k/server.key", tmp_path / "other/client.key_secret")
        assert request(server.endpoint, "status", keys=trusted) == {"frames": 5}
        with pytest.raises(ControlError, match="no answer"):
            request(server.endpoint, "stop", keys=stranger, timeout_s=0.3)
        with pytest.raises(EndpointError, match="needs CURVE keys, even on this machine: give --server-key"):
            request(server.endpoint, "stop")
        assert not recorder.stopped
    finally:
        server.close()


def test_a_running_runtime_takes_clouds_references_and_stop(virtual_skin, running, tmp_path):
    with virtual_skin(touches=[[0.2, 60, 0.3]], touches_wait=True) as port, running(port, tmp_path) as runtime:
        control = runtime.control.endpoint
        with eitskin.subscribe(runtime.publisher.endpoint, mode="all", timeout_s=60) as frames:
            assert next(frames).cloud == 0
            assert eitskin.send_cloud(control, flat_cloud() + 5.0) == 1
            assert next(frame for frame in frames if frame.cloud == 1 and frame.touched).solver == "vd2t"
            with pytest.raises(ControlError, match="0 mm along x and 0 mm along y, expected"):
                request(control, "cloud", cloud=bytes(16200))
            status = request(control, "status")
            assert status["cloud"] == 1
            # a starved machine may overflow the line; nothing that came whole while frames were read is kept back
            assert status["withheld"] == status["withheld_by_reason"]["stale"]
            with pytest.raises(ControlError, match=r"differs from the reference of .* expected at most 10%.*--force"):
                request(control, "reference", frames=20, timeout_s=60)
            # forced, the touch that is held now becomes the new zero
            answer = request(control, "reference", frames=20, force=True, timeout_s=60)
            assert answer["weak_rows"] == []
            assert answer["older_difference"] > 0.1
            assert answer["remarks"]
            assert not next(frame for frame in frames if "reference" in frame.events).touched
        request(control, "stop")
        runtime.thread.join(60)
        assert not runtime.thread.is_alive()
        assert runtime.error is None


def test_a_failure_in_the_thread_of_control_ends_no_server(server, raw, monkeypatch):
    fail = iter([MemoryError("no memory"), OSError(12, "Cannot allocate memory"), RuntimeError("anything")])
    real = control.answer_of

    def answer_of(perform):
        if (error := next(fail, None)) is not None:
            raise error
        return real(perform)

    monkeypatch.setattr(control, "answer_of", answer_of)
    with zmq.Context() as context:
        for _ in range(3):  # nobody waits for these answers
            with context.socket(zmq.REQ) as socket:
                socket.connect(server.endpoint)
                socket.send(msgpack.packb({"command": "status"}))
                assert not socket.poll(100)
                socket.linger = 0
    assert raw(msgpack.packb({"command": "status"}))["ok"] is True
