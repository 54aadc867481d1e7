"""A recording while it is made: what is forced onto the disk."""

import errno
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from eitskin_tools.recording import writer as sinks
from eitskin_tools.recording.layout import WIRE
from eitskin_tools.recording.reader import Recording
from eitskin_tools.recording.writer import Series


def test_each_second_what_was_written_in_it_is_forced_onto_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced, now_s = [0], [0.0]
    monkeypatch.setattr(sinks, "os", _with(os, fdatasync=lambda handle: synced.append(os.fstat(handle).st_size)))
    series = Series(tmp_path / "a.mcap", {}, now_s=lambda: now_s[0])
    for second in range(10):
        before = series.size
        for number in range(50):
            now_s[0] = second + 0.02 * (number + 1)
            series.add(WIRE, os.urandom(300), number, number)
        assert synced[-1] == series.size > before
    series.close()


def test_an_end_that_does_not_get_onto_the_disk_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A network's disk says so late: each write went well."""

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    series = Series(tmp_path / "a.mcap", {})
    monkeypatch.setattr(sinks, "os", _with(os, fsync=full))
    for number in range(3):
        series.add(WIRE, os.urandom(300), number, number)
    with pytest.raises(OSError, match="No space left"):
        series.close()
    series.close()  # twice is fine
    assert sum(1 for path in series.files for _ in Recording(path).entries({WIRE.topic})) == 3


def _with(module: Any, **other: Any) -> Any:
    """Return what stands for a module, some of its names otherwise."""
    return SimpleNamespace(**{**vars(module), **other})
