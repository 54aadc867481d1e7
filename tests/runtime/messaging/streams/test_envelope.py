"""The outside of a stream's message: bytes that select it, parts, and what is no message."""

import msgpack
import numpy as np
import pytest

from eitskin.errors import FrameError
from eitskin.messaging.frame import FIRST_BYTE, LARGEST_MESSAGE, TOUCH_FIRST_BYTE, unpack_frame
from eitskin.messaging.streams.envelope import NAMES, PIECE, TOPICS, BodyJoiner, asked_for, opened, packed

RNG = np.random.default_rng(5)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size", [0, 1, PIECE - 1, PIECE, PIECE + 1, 5 * PIECE])
def test_a_body_comes_out_as_it_went_in(name, size):
    body = RNG.bytes(size)
    messages = packed(name, 2**40, "abcd0123", body)
    joiner = BodyJoiner()
    whole = [joiner.add(opened(message)) for message in messages]
    assert whole[:-1] == [None] * (len(messages) - 1)
    assert whole[-1] == body
    assert joiner.broken == 0
    for message in messages:
        assert len(message) <= LARGEST_MESSAGE
        assert message.startswith(TOPICS[name])
        assert msgpack.unpackb(message)["v"] == 3


@pytest.mark.parametrize("name", NAMES)
def test_a_stream_is_selected_by_what_its_messages_begin_with(name):
    message = packed(name, 7, "r", b"")[0]
    for topic in (b"\x86", TOPICS[name][:3], TOPICS[name], message[:20]):
        assert asked_for(name, topic)
    others = (b"", FIRST_BYTE, TOUCH_FIRST_BYTE, b"eitskin/touches", b"\x85", b"\x86\xa1", TOPICS[name][:-1] + b"x")
    for topic in others:
        assert not asked_for(name, topic)
    assert [other for other in NAMES if TOPICS[name].startswith(TOPICS[other])] == [name]


def test_streams_begin_like_neither_frames_nor_touches():
    for name in NAMES:
        message = packed(name, 1, "r", b"x")[0]
        assert message[:1] not in (FIRST_BYTE, TOUCH_FIRST_BYTE)
        with pytest.raises(FrameError, match="version"):
            unpack_frame(message, 0)


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"other": 1, "v": 3, "run": "r", "part": 0, "parts": 1, "body": b""},
        {"wire": 1, "v": 4, "run": "r", "part": 0, "parts": 1, "body": b""},
        {"wire": -1, "v": 3, "run": "r", "part": 0, "parts": 1, "body": b""},
        {"wire": 1.0, "v": 3, "run": "r", "part": 0, "parts": 1, "body": b""},
        {"wire": 1, "v": 3, "run": "r" * 65, "part": 0, "parts": 1, "body": b""},
        {"wire": 1, "v": 3, "run": "r", "part": 1, "parts": 1, "body": b""},
        {"wire": 1, "v": 3, "run": "r", "part": 0, "parts": 33, "body": b""},
        {"wire": 1, "v": 3, "run": "r", "part": 0, "parts": 1, "body": "text"},
        {"wire": 1, "v": 3, "run": "r", "part": True, "parts": 1, "body": b""},
        {"wire": 1, "v": 3, "run": "r", "part": 0, "parts": 1},
        [1, 2],
        7,
    ],
)
def test_what_is_no_message_is_refused(fields):
    with pytest.raises(FrameError):
        opened(msgpack.packb(fields))
