"""A recording as a page gets it: the maps that were published, second by second, and what the bar has marks for."""

import json
from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from tests.tools.view.unpacking import unpacked

from eitskin import Frame, WireFrame
from eitskin_tools.recording.layout import FRAME
from eitskin_tools.recording.reader import Entry
from eitskin_tools.view import film as parts_module
from eitskin_tools.view.film import MAX_MARKS, Film, Overview

from ..recording.conftest import TINY, measured, recorded

MOST_BY_NOISE = 5
"""Levels of 255 by which a map may differ from that of another frame in which only noise had changed; 2 at most did,
wherever parts began."""


@pytest.fixture(scope="module")
def items():
    return measured(skip_unchanged=True)


@pytest.fixture
def path(tmp_path, items):
    ticks = count()
    recorded(tmp_path / "a.mcap", items, now_s=lambda: 0.02 * next(ticks))
    return tmp_path / "a.mcap"


def messages(film):
    return [message for number in range(film.parts) for message in unpacked(film.part(number))]


def test_all_parts_together_show_every_published_frame_with_its_map(path, items, monkeypatch):
    monkeypatch.setattr(parts_module, "PART_S", 0.1)
    published = [item for item in items if isinstance(item, Frame)]
    film = Film(path, TINY)
    parts = [[one for one in unpacked(film.part(n)) if one[0]["kind"] == "frame"] for n in range(film.parts)]
    found = [frame for part in parts for frame in part]
    begins = [part[0][0]["seq"] for part in parts for _ in part]
    assert [head["seq"] for head, _ in found] == [frame.sequence for frame in published]
    for (head, body), frame, begin in zip(found, published, begins, strict=True):
        levels = np.rint(np.clip(frame.map, 0.0, 1.0) * 255.0)
        shown = np.frombuffer(body, dtype=np.uint8).reshape(levels.shape)
        # A map of frames from before its part is computed anew, of the part's frames: only noise had changed.
        before = frame.map_sequence - 2 * frame.fused < begin
        np.testing.assert_allclose(shown, levels, atol=MOST_BY_NOISE if before else 0)
        assert (head["touched"], head["n"], head["cloud"]) == (frame.touched, frame.number, frame.cloud)
        assert head["counts"] == frame.counts
    times = [head["t_ms"] for head, _ in found]
    assert times == sorted(times)
    assert (times[0], times[-1]) == pytest.approx((0.0, 1000.0 * film.seconds))


def test_a_recording_of_the_wire_alone_has_maps_too(tmp_path, items):
    alone = [
        replace(item, frame=None, solver="none", map_seq=None) if isinstance(item, WireFrame) else item
        for item in items if not isinstance(item, Frame)
    ]  # fmt: skip
    recorded(tmp_path / "w.mcap", alone)
    found = [(head, body) for head, body in messages(Film(tmp_path / "w.mcap", TINY)) if head["kind"] == "frame"]
    touched = [max(body) for head, body in found if head["touched"]]
    assert len(touched) > 20
    assert all(0 <= value <= 255 for value in touched)
    assert any(touched)


def test_the_overview_has_what_happened_when(path, items):
    film = Film(path, TINY)
    ((head, _),) = unpacked(list(film.overview())[-1])
    assert head["share"] == 1.0
    touched = [item for item in items if isinstance(item, Frame) and item.touched]
    assert len(head["touched"]) == 1
    begin, end = head["touched"][0]
    shown = [one["t_ms"] for one, _ in messages(film) if one["kind"] == "frame" and one["touched"]]
    assert (begin, end) == (shown[0], shown[-1]), "a mark is exactly at its frame"
    assert len(touched) > 20
    assert sum(row["losses"]["lost"] for row in head["rows"]) == 0
    assert max(row["peak"] for row in head["rows"]) == pytest.approx(max(item.map.max() for item in touched), abs=1e-3)
    assert all(0.0 <= row["t"] <= film.seconds for row in head["rows"])


def note(at_s, **fields):
    return Entry(FRAME.topic, int(at_s * 1e9), 0, json.dumps(fields).encode())


def test_losses_and_events_are_marked_once_and_within_bounds():
    overview = Overview(100.0, 0)
    for k in range(100):
        overview.add(note(k, events=["saturated"], counts={"lost": k, "corrupt": 5 if k >= 50 else 0}))
        overview.add(note(k + 0.1, events=["saturated"]))
    for k in range(2 * MAX_MARKS):
        overview.add(note(0.01 * k, events=[f"electrode:{k}"]))
    ((head, _),) = unpacked(overview.message(done=False))
    assert [text for _, text in head["events"]].count("A row exceeds the converter's range") == 100
    assert len(head["events"]) == MAX_MARKS
    assert [(row["lost_ms"], row["losses"]["corrupt"]) for row in head["rows"] if row["losses"]["corrupt"]] == [
        (50000.0, 5)
    ]
    assert head["share"] == pytest.approx(0.99, abs=0.02)


def test_parts_are_kept_within_bounds_and_computed_again(path, monkeypatch):
    monkeypatch.setattr(parts_module, "PART_S", 0.02)
    film = Film(path, TINY)
    assert film.part(0) is film.part(0)
    monkeypatch.setattr(parts_module, "MAX_CACHED_BYTES", 1)
    film = Film(path, TINY)
    first = film.part(0)
    assert film.parts > 1
    assert messages(film)
    again = film.part(0)
    assert again == first
    assert again is not first
