"""The viewer's subscriber: it takes the newest, lists its touches, and rests while nobody looks on."""

import time

import pytest
from tests.tools.view.unpacking import unpacked

import eitskin
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.view import feed as feed_module
from eitskin_tools.view.board import Board
from eitskin_tools.view.feed import Feed
from eitskin_tools.view.source import Source

from .scripted import Runtime, Scene, cylinder, disc


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
    with Runtime(endpoint, Scene(disc(50.0, 40.0))) as runtime:
        with eitskin.subscribe(endpoint, timeout_s=60.0) as other:
            for _ in range(20):
                other.next_frame()
            assert len(runtime.topics) == 1
            with board.page():
                while len(runtime.topics) == 1:
                    other.next_frame()
            while len(runtime.topics) > 1:
                other.next_frame()
        assert feed.taken > 0
    feed.close()


def test_a_page_has_the_runtime_list_no_touches_and_shows_those_that_others_ask_for(endpoint):
    """Its own ones lie on the surface in use as well."""
    board = Board()
    feed = Feed(Source(PAPER, endpoint), board)
    scene = Scene(disc(50.0, 40.0), cloud=1, cloud_mm=cylinder())
    with Runtime(endpoint, scene) as runtime, board.page():
        feed.start()
        (own,) = heads(board, "frame", 3)[-1]["touches"]
        assert not runtime.touches_asked
        with eitskin.subscribe(endpoint, touches=True, timeout_s=60.0) as other:
            (touch,) = other.next_frame().touches
            (shown,) = heads(board, "frame", 30)[-1]["touches"]
        feed.close()
    assert shown["centre"] == own["centre"] == pytest.approx(touch.centre_mm, abs=0.01)
    assert shown["place"] == pytest.approx(touch.place_mm, abs=0.01)


def test_silence_is_told_with_its_reason(endpoint):
    board = Board()
    feed = Feed(Source(PAPER, endpoint), board)
    feed.start()
    with board.page():
        (head,) = heads(board, "status", 1)
    feed.close()
    assert head["state"] == "silent"
    assert "eitskin run" in head["text"]


def test_a_feed_ends_at_once_while_no_frame_arrives(endpoint, monkeypatch):
    monkeypatch.setattr(feed_module, "SILENCE_S", 600.0)
    board = Board()
    feed = Feed(Source(PAPER, endpoint), board)
    with Runtime(endpoint, Scene(disc(50.0, 40.0))), board.page():
        feed.start()
        heads(board, "frame", 1)
    begin_s = time.monotonic()
    feed.close()
    assert time.monotonic() - begin_s < 60.0
