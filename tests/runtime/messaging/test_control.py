import stat
import time
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zmq

import eitskin
from eitskin.errors import ControlError, EndpointError
from eitskin.messaging.control import ControlServer
from eitskin.messaging.control_client import request
from eitskin.messaging.control_commands import LARGEST_REQUEST
from eitskin.messaging.curve_keys import load_client_keys, load_server_keys, make_keys
from eitskin_proto.skin.cloud import flat_cloud


def test_only_the_owner_may_reach_the_control_socket(server):
    mode = Path(server.endpoint.removeprefix("ipc://")).stat().st_mode
    assert stat.S_IMODE(mode) == 0o600


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


def test_random_and_hostile_bytes_are_answered_and_the_server_lives_on(server, raw, recorder):
    rng = np.random.default_rng(4)
    hostile = [b"", b"\x91" * 20000, b"\xdf\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff", b"\xd6\xff\0\0\0\0",
               b"\x81\x01\x02", b"\x81\xa7command" + b"\x81" * 2000, b"cposix\nsystem\n(S'true'\ntR."]  # fmt: skip
    hostile += [rng.integers(0, 256, size, dtype=np.uint8).tobytes() for size in rng.integers(0, 300, 100)]
    valid = msgpack.packb({"command": "cloud", "cloud": bytes(16200)})
    for _ in range(100):
        damaged = bytearray(valid)
        damaged[int(rng.integers(0, 25))] ^= 1 << int(rng.integers(0, 8))
        hostile.append(bytes(damaged))
    for message in hostile:
        answer = raw(message)
        assert isinstance(answer, dict)
    assert raw(b"a", b"b")["ok"] is False
    assert raw(msgpack.packb({"command": "status"})) == {"ok": True, "frames": 5}
    assert server.refused > 100


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


def test_a_client_that_vanishes_before_its_answer_disturbs_nobody(server, raw):
    for _ in range(20):
        context = zmq.Context()
        socket = context.socket(zmq.DEALER)
        socket.linger = 0
        socket.connect(server.endpoint)
        socket.send_multipart([b"", msgpack.packb({"command": "status"})])
        context.destroy(0)
    assert raw(msgpack.packb({"command": "status"}))["ok"] is True


def test_a_fault_in_the_runtime_is_an_answer_not_an_end(server, raw, recorder, monkeypatch):
    monkeypatch.setattr(recorder, "status", lambda: 1 / 0)
    assert raw(msgpack.packb({"command": "status"})) == {
        "ok": False,
        "error": "the runtime failed at this request: ZeroDivisionError",
    }
    assert raw(msgpack.packb({"command": "reference", "frames": 5}))["ok"] is True


def test_a_runtime_that_is_not_there_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("eitskin.messaging.reachability.runtime_folders", list)
    with pytest.raises(ControlError, match="is the runtime running"):
        request(f"ipc://{tmp_path}/nobody", "status", timeout_s=0.1)
    with pytest.raises(
        ControlError, match=r"there is no .*/nobody; .*eitskin run --port PORT --control ipc://.*/nobody"
    ):
        eitskin.send_cloud(f"ipc://{tmp_path}/nobody", flat_cloud(), timeout_s=0.1)
    with pytest.raises(EndpointError):
        request("nothing", "status", timeout_s=0.1)


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
        with pytest.raises(EndpointError, match="needs CURVE keys, on this machine too: give --server-key"):
            request(server.endpoint, "stop")
        assert not recorder.stopped
    finally:
        server.close()


def test_a_running_runtime_takes_clouds_references_and_stop(virtual_skin, running, tmp_path):
    with virtual_skin(touches=[[0.2, 60, 0.3]]) as port, running(port, tmp_path) as runtime:
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


def test_frames_that_nobody_takes_are_judged_but_not_computed(virtual_skin, running, tmp_path):
    with virtual_skin(touches=[[0.2, 60, 0.3]]) as port, running(port, tmp_path) as runtime:
        statistics, end = runtime.skin.statistics, time.perf_counter() + 60
        while statistics.skipped.get("inference:no_subscriber", 0) <= 20 and time.perf_counter() < end:
            time.sleep(0.02)
        assert statistics.skipped["inference:no_subscriber"] > 20
        assert set(statistics.solvers) == {"none"}
        with eitskin.subscribe(runtime.publisher.endpoint, timeout_s=60) as frames:
            assert next(frames).solver == "vd2t"


def test_closing_takes_the_file_along_and_leaves_the_address_free(tmp_path, recorder):
    for _ in range(3):
        ControlServer(f"ipc://{tmp_path}/again", recorder).close()
        assert not (tmp_path / "again").exists()
