"""Any part of a recording, read without what comes before it, is what the whole of it says."""

from itertools import count, pairwise
from pathlib import Path
from typing import Any

import pytest

from eitskin_tools.recording.layout import CLOUD, WIRE
from eitskin_tools.recording.reader import Recording
from eitskin_tools.recording.script import Script, Step

from .conftest import recorded


@pytest.fixture
def chunked(tmp_path: Path, items: list[Any]) -> Path:
    """A recording of some thirty chunks."""
    ticks = count()
    recorded(tmp_path / "c.mcap", items, now_s=lambda: 0.02 * next(ticks))
    return tmp_path / "c.mcap"


def told(step: Step) -> tuple[Any, ...]:
    """Return what a step says, so that two can be held against each other."""
    conditions, cloud = step.conditions, step.cloud
    return (
        step.frame, step.log_ns, conditions and conditions.revision, cloud and cloud.cloud.tobytes(), step.reference,
    )  # fmt: skip


def at_s(found: Script, step: Step) -> float:
    """Return when a frame came, after the first one; a quarter of a ns later, so that no rounding leaves it out."""
    return (step.log_ns - found.first_ns + 0.25) * 1e-9


def test_parts_together_are_the_whole_and_each_begins_with_what_held(chunked: Path) -> None:
    script, found = Script(chunked), Script(chunked)
    assert len(Recording(chunked).chunks) > 20
    assert (found.first_ns, found.last_ns, found.seconds) == (script.first_ns, script.last_ns, script.seconds)
    whole = list(script.steps())
    begins = [at_s(found, whole[k]) for k in range(0, 150, 20)]
    parts = [list(found.part(begin, end - 1e-9)) for begin, end in pairwise([*begins, found.seconds + 1.0])]
    assert [step.frame for part in parts for step in part] == [step.frame for step in whole]
    for begin, part in zip(begins, parts, strict=True):
        first = next(script.steps(begin))
        assert told(part[0])[2:] == told(first)[2:]
        assert part[0].reference is not None
    assert all(step.note["number"] == step.frame.frame for part in parts for step in part)


def test_a_part_is_found_without_reading_the_others(chunked: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found, read = Script(chunked), []
    whole = list(Script(chunked).steps())
    plain = Recording.read
    monkeypatch.setattr(Recording, "read", lambda self, number: read.append(number) or plain(self, number))
    steps = list(found.steps(at_s(found, whole[100]), at_s(found, whole[103]) + 1e-9))
    assert [step.frame for step in steps] == [step.frame for step in whole[100:104]]
    assert steps[0].cloud is not None
    assert len(set(read)) < len(Recording(chunked).chunks) / 2


def test_the_index_says_which_chunks_have_clouds(chunked: Path) -> None:
    places = Recording(chunked)
    clouds = places.having(CLOUD.topic)
    assert 0 < len(clouds) < len(places.having(WIRE.topic))
    assert all(any(entry.topic == CLOUD.topic for entry in places.read(number)) for number in clouds)
