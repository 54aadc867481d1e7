"""The viewer's subscriber: it asks for touches, takes the newest, and rests while nobody looks on."""

import socket

import pytest

import eitskin
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.view.board import Board
from eitskin_tools.view.feed import Feed
from eitskin_tools.view.messages import unpacked
from eitskin_tools.view.source import Source
from eitskin_tools.view.viewer import Viewer

from .scripted import Runtime, Scene, disc


@pytest.fixture
def endpoint(tmp_path):
    return f"ipc://{tmp_path}/frames"


def heads(board, kind, count):
    """Return the heads of so many messages of a kind, one posted after the other."""
    found, seen = [], 0
    while len(found) < count:
        seen, messages = board.newer(seen, 60.0)
        found += [head for message in messages for head, _ in unpacked(message) if head["kind"] == kind]
    return found


def test_frames_come_newest_first_with_their_touches_and_fewer_than_are_published(endpoint):
    board = Board()
    feed = Feed(Source(PAPER, endpoint), board)
    with Runtime(endpoint, Scene(disc(50.0, 40.0)), rate_hz=400.0) as runtime, board.page():
        feed.start()
        found = heads(board, "frame", 12)
        first, last = found[0]["n"], found[-1]["n"]
        assert runtime.sent >= last
        feed.close()
    assert [head["n"] for head in found] == sorted({head["n"] for head in found})
    assert last - first > 2 * len(found)  # 400 a second were published, 30 at most taken
    (touch,) = found[-1]["touches"]
    assert touch["centre"] == pytest.approx([50.0, 40.0], abs=0.2)
    assert found[-1]["stages_us"] == pytest.approx([40, 20, 30, 250, 25, 15])


def test_nobody_is_subscribed_while_nobody_looks_on(endpoint):
    board = Board()
    feed = Feed(Source(PAPER, endpoint), board)
    feed.start()
    with Runtime(endpoint, Scene(disc(50.0, 40.0))):
        with eitskin.subscribe(endpoint, timeout_s=60.0) as other:
            assert all(other.next_frame().touch_list is None for _ in range(20))
            with board.page():
                while other.next_frame().touch_list is None:
                    pass
            while other.next_frame().touch_list is not None:
                pass
        assert feed.taken > 0
    feed.close()


def test_silence_is_told_with_its_reason(endpoint):
    board = Board()
    feed = Feed(Source(PAPER, endpoint), board)
    feed.start()
    with board.page():
        (head,) = heads(board, "status", 1)
    feed.close()
    assert head["state"] == "silent"
    assert "eitskin run" in head["text"]


def test_an_endpoint_that_is_none_is_refused_at_once():
    with pytest.raises(eitskin.EndpointError):
        Feed(Source(PAPER, "nonsense"), Board())


def test_a_page_that_reads_nothing_costs_neither_a_subscriber_nor_another_page_a_frame(endpoint):
    with Runtime(endpoint, Scene(disc(50.0, 40.0)), rate_hz=200.0), Viewer([Source(PAPER, endpoint)]) as viewer:
        ask = f"GET /stream HTTP/1.1\r\nHost: 127.0.0.1:{viewer.server.port}\r\n\r\n".encode()
        with (
            socket.create_connection(("127.0.0.1", viewer.server.port)) as stalled,
            socket.create_connection(("127.0.0.1", viewer.server.port)) as read,
            eitskin.subscribe(endpoint, mode="all", timeout_s=60.0) as other,
        ):
            stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            for line in (stalled, read):
                line.sendall(ask)
                assert line.recv(12) == b"HTTP/1.1 200"
            numbers = [other.next_frame().number for _ in range(400)]
            taken, got = viewer.feeds[0].taken, 0
            while viewer.feeds[0].taken < taken + 10 or got < 100_000:
                got += len(read.recv(65536))
    assert numbers == list(range(numbers[0], numbers[0] + 400))
