"""Answers of the control server: to whom they go, and when."""

import threading
import time

import msgpack
import pytest
import zmq

import eitskin
from eitskin.errors import ControlError
from eitskin.messaging.control_client import request


@pytest.fixture
def dealer(server):
    """Return a function that makes a client which frames its messages itself."""
    context, made = zmq.Context(), []

    def make():
        socket = context.socket(zmq.DEALER)
        socket.linger = 0
        socket.connect(server.endpoint)
        made.append(socket)
        return socket

    yield make
    for socket in made:
        socket.close()
    context.term()


def answer(socket):
    assert socket.poll(60_000)
    *envelope, packed = socket.recv_multipart()
    return envelope, msgpack.unpackb(packed)


def test_a_message_without_a_delimiter_is_answered_and_costs_nobody_an_answer(server, raw, dealer):
    rude = dealer()
    for parts in ([b"x"], [b"x", b"y"], [b"x"] * 40, [msgpack.packb({"command": "status"})]):
        rude.send_multipart(parts)
        assert raw(msgpack.packb({"command": "status"})) == {"ok": True, "frames": 5}
        envelope, found = answer(rude)
        assert envelope == [b""]
        assert "has no empty part before the map" in found["error"]
    rude.send_multipart([b""])
    assert answer(rude)[1]["error"] == "a message of 0 parts; expected one"


class Slow:
    """Frames that do not come until they are let through, or the runtime is stopped."""

    def __init__(self, recorder):
        self.begun, self.release = threading.Event(), threading.Event()
        recorder.recapture, recorder.stop = self.recapture, self.release.set

    def recapture(self, frames, *, force=False):
        self.begun.set()
        assert self.release.wait(60)
        return {"frames": frames, "weak_rows": []}


def test_everything_else_is_answered_while_a_reference_is_captured(recorder, raw, dealer):
    slow, asking = Slow(recorder), dealer()
    asking.send_multipart([b"", msgpack.packb({"command": "reference", "frames": 9})])
    assert slow.begun.wait(60)
    assert raw(msgpack.packb({"command": "status"})) == {"ok": True, "frames": 5}
    second = raw(msgpack.packb({"command": "reference", "frames": 9}))
    assert second == {"ok": False, "error": "a reference is already being captured; ask again when it is done"}
    assert not asking.poll(0)
    assert raw(msgpack.packb({"command": "stop"}))["ok"] is True
    assert answer(asking)[1] == {"ok": True, "frames": 9, "weak_rows": []}
    assert raw(msgpack.packb({"command": "reference", "frames": 8}))["frames"] == 8


def test_stop_ends_a_reference_that_is_being_captured_at_once(virtual_skin, running, tmp_path):
    with virtual_skin() as port, running(port, tmp_path) as runtime:
        control, answers = runtime.control.endpoint, []

        def ask():
            try:
                answers.append(request(control, "reference", frames=10_000, timeout_s=60))
            except ControlError as error:
                answers.append(str(error))

        asking = threading.Thread(target=ask)
        asking.start()
        end = time.perf_counter() + 60
        while runtime.skin.loop._recapture is None and time.perf_counter() < end:
            request(control, "status")
        with pytest.raises(ControlError, match="is already being captured"):
            request(control, "reference", frames=20)
        with pytest.raises(eitskin.BadReference, match="of 10000 frames of another reference are in"):
            runtime.skin.recapture(20)
        request(control, "stop")
        asking.join(60)
        assert answers == ["stopped while capturing the reference; the old one stays"]
        runtime.thread.join(60)
        assert runtime.error is None
        with pytest.raises(eitskin.BadReference, match="stopped while"):
            runtime.skin.recapture(20)
