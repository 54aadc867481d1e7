"""Answers of the control server: to whom they go, and when."""

import threading

import msgpack
import pytest
import zmq


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
