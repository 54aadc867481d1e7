"""Who waits for a stream: ``eitskin replay --wait`` for subscribers, ``eitskin record`` for what it can use."""

import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest

from eitskin.errors import NoFrame
from eitskin_tools.commands.recorded import replay
from eitskin_tools.recording.recorder import Intake


class Coming:
    """A publisher to which topics come, each at a look."""

    def __init__(self, comes: dict[int, bytes]) -> None:
        self._comes, self.looks = comes, 0
        self.topics: frozenset[bytes] = frozenset()
        self.wanted = False
        self.streams = SimpleNamespace(asked=False)

    def look(self) -> None:
        self.looks += 1
        if topic := self._comes.get(self.looks):
            self.topics = self.topics | {topic}
            self.streams.asked |= topic == b"stream"
            self.wanted |= topic == b"frames"


@pytest.mark.parametrize(
    ("comes", "last"),
    [
        ({3: b"frames"}, 3),
        ({3: b"stream", 20: b"frames"}, 20),
        ({3: b"unknown", 90: b"stream", 100: b"frames", 130: b"more"}, 130),
    ],
)
def test_it_begins_when_nothing_more_is_subscribed_to(
    monkeypatch: pytest.MonkeyPatch, comes: dict[int, bytes], last: int
) -> None:
    now_s = [0.0]
    clock: Any = SimpleNamespace(monotonic=lambda: now_s[0], sleep=lambda s: now_s.__setitem__(0, now_s[0] + s))
    monkeypatch.setattr(replay, "time", clock)
    publisher = Coming(comes)
    replay._wait(SimpleNamespace(stopping=False), publisher)
    assert publisher.looks - last == pytest.approx(replay.SETTLED_S / replay.LOOK_S, abs=2)


def test_it_ends_when_nobody_waits_any_more(monkeypatch: pytest.MonkeyPatch) -> None:
    skin: Any = SimpleNamespace(stopping=False)
    publisher = Coming({})
    monkeypatch.setattr(
        replay, "time", SimpleNamespace(monotonic=lambda: 0.0, sleep=lambda _: setattr(skin, "stopping", True))
    )
    replay._wait(skin, publisher)
    assert publisher.looks == 1


class Unusable:
    """A subscription to which messages come that it cannot use, and one that it can once that was seen."""

    def __init__(self) -> None:
        self.rejected, self.waits, self.closed = 0, False, False
        self.seen = threading.Event()

    def __iter__(self) -> "Unusable":
        return self

    def __next__(self) -> object:
        if self.rejected:
            self.seen.wait(60.0)
            return "usable"
        self.rejected += 1
        raise NoFrame(f"{self.rejected} of version 4, expected 3")

    def close(self) -> None:
        self.closed = True


def test_a_recorder_tells_what_cannot_be_used_from_silence() -> None:
    source = Unusable()
    intake = Intake([lambda: source])
    try:
        end_s = time.monotonic() + 60.0
        while intake.unusable is None and time.monotonic() < end_s:
            time.sleep(0.001)
        assert "of version 4, expected 3" in str(intake.unusable)
        source.seen.set()
        assert intake.next(60.0) == "usable"
        assert intake.unusable is None
    finally:
        intake.close()
    assert source.closed
