"""A subscriber to whom nothing comes: where it waited, who is there, what to do; the endpoint it takes unasked."""

import pytest
import zmq

import eitskin
from eitskin.errors import NoFrame
from eitskin.messaging import endpoints
from eitskin.messaging.publish import Publisher
from eitskin.messaging.streams.envelope import packed
from eitskin.messaging.streams.subscription import subscribe_streams
from eitskin.messaging.streams.verified import TOPIC
from eitskin.messaging.streams.verified_subscription import subscribe_verified


@pytest.fixture
def session(monkeypatch, tmp_path):
    """A session's folder of its own, so that no runtime of this machine is met."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


def said_to(endpoint, timeout_s=0.05):
    with eitskin.subscribe(endpoint, timeout_s=timeout_s) as frames, pytest.raises(NoFrame) as caught:
        next(frames)
    return str(caught.value)


def test_publisher_and_subscriber_take_the_same_endpoint_by_default(session):
    assert endpoints.default_publish() == f"ipc://{session}/eitskin/frames"
    with eitskin.subscribe() as frames:
        assert frames.endpoint == endpoints.default_publish()


def test_an_endpoint_where_nobody_ever_was_is_named_with_what_to_do(session):
    text = said_to(None)
    assert f"no frame from ipc://{session}/eitskin/frames within 0.05 s: no runtime listens there" in text
    assert "the socket does not exist" in text
    assert "'eitskin run --port PORT'" in text
    assert "\n" not in text


def test_somebody_who_says_nothing_is_told_from_nobody(session):
    publisher = Publisher(f"ipc://{session}/frames")
    try:
        assert "a program listens there, but sends no frame" in said_to(publisher.endpoint)
    finally:
        publisher.close()


@pytest.fixture
def alone(session, monkeypatch):
    """Return the only runtime folder, whatever runs on this machine."""
    folder = session / "eitskin"
    folder.mkdir(mode=0o700)
    monkeypatch.setattr("eitskin.messaging.reachability.runtime_folders", lambda: [folder])
    return folder


def test_skins_of_a_robot_are_named_with_what_shows_one_and_all(alone):
    (alone / "robot.json").touch()
    publishers = []
    for name in ("left", "right"):
        (alone / name).mkdir()
        publishers.append(Publisher(f"ipc://{alone}/{name}/frames"))
    try:
        text = said_to(None)
    finally:
        for one in publishers:
            one.close()
    assert (
        f"skins run: left, right; see one with 'eitskin subscribe ipc://{alone}/left/frames', or all with "
        "'eitskin status --all'"
    ) in text
    assert "--port" not in text


@pytest.fixture
def newer(session):
    """A runtime of another release: what it sends is up to the test."""
    context = zmq.Context()
    socket = context.socket(zmq.XPUB)
    socket.setsockopt(zmq.XPUB_VERBOSE, 1)
    socket.setsockopt(zmq.RCVTIMEO, 60_000)
    socket.bind(f"ipc://{session}/newer")
    yield socket, f"ipc://{session}/newer"
    context.destroy(linger=0)


def said_after(newer, opened, message, ask):
    """Return what a subscriber is told to whom one message came."""
    with opened(newer[1], timeout_s=0.05) as found:
        while not ((said := newer[0].recv())[:1] == b"\x01" and message.startswith(said[1:])):
            pass  # it has not subscribed yet
        newer[0].send(message)
        assert found.socket.poll(60_000)
        with pytest.raises(NoFrame) as caught:
            ask(found)
        with pytest.raises(NoFrame, match="a program listens there"):
            ask(found)  # nothing came meanwhile
    assert found.rejected == 1
    return str(caught.value)


def all_frames(endpoint, **wishes):
    return eitskin.subscribe(endpoint, "all", **wishes)


def test_what_cannot_be_used_is_told_from_silence(newer, packer):
    frame = bytes(packer.message())
    (stream,) = packed("wire", 1, "r", b"\x80")
    another = frame.replace(b"\xa1v\x01", b"\xa1v\x02")
    for opened, message, said in (
        (
            eitskin.subscribe,
            another,
            "none is a usable frame: found frames of version 2, expected 1: use",
        ),
        (all_frames, another, "none is a usable frame: found frames of version 2, expected 1: use"),
        (all_frames, frame[:-20], "none is a usable frame: a message of"),
        (subscribe_streams, stream.replace(b"\xa1v\x03", b"\xa1v\x04"), "stream version: found 4, expected 3"),
        (subscribe_verified, TOPIC + b"damaged", "none is a usable verdict"),
    ):
        assert said in said_after(newer, opened, message, next)
