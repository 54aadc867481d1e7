"""A recording while it is made: what is forced onto the disk, and the line that says how far it is."""

import contextlib
import errno
import os
import pty
import random
import select
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from eitskin import SkinState, WireFrame
from eitskin_tools.commands.recorded import record
from eitskin_tools.recording import writer as sinks
from eitskin_tools.recording.layout import WIRE
from eitskin_tools.recording.reader import Recording
from eitskin_tools.recording.recorder import Recorder, RecorderOptions
from eitskin_tools.recording.writer import Series

PATIENCE_S = 60.0

LATE_S = 0.3
"""What came longer ago is said to be in the file when the recorder is killed."""

STEADY = 80
"""Frames that come 5 ms apart; those behind them come when they like."""


class Disk:
    """Counts what is forced onto it, and up to which byte."""

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.calls = self.bytes = 0

    def fdatasync(self, handle: int) -> None:
        with self.changed:
            self.calls += 1
            self.bytes = os.fstat(handle).st_size
            self.changed.notify_all()

    def wait_for(self, size: int) -> bool:
        with self.changed:
            return self.changed.wait_for(lambda: self.bytes >= size, PATIENCE_S)


def test_each_second_what_was_written_in_it_is_forced_onto_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, now_s = Disk(), [0.0]
    monkeypatch.setattr(sinks, "os", _with(os, fdatasync=disk.fdatasync))
    series = Series(tmp_path / "a.mcap", {}, now_s=lambda: now_s[0])
    for second in range(10):
        before = series.size
        for number in range(50):
            now_s[0] = second + 0.02 * (number + 1)
            series.add(WIRE, os.urandom(300), number, number)
        assert series.size > before
        assert disk.wait_for(series.size), f"second {second} is not on the disk"
        assert disk.calls > second
    series.close()


def test_where_nothing_comes_what_came_is_forced_onto_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk()
    monkeypatch.setattr(sinks, "os", _with(os, fdatasync=disk.fdatasync))
    series = Series(tmp_path / "a.mcap", {}, now_s=lambda: 0.0)
    series.add(WIRE, b"last", 0, 0)
    before = series.size
    ended = record._Stop()

    def silence(timeout_s: float) -> None:
        ended.asked = disk.calls > 0 or disk.wait_for(before + 1) if series.size > before else False

    recorder: Any = SimpleNamespace(series=series, full=False, frames=1, recorded_s=0.0)
    words = SimpleNamespace(seconds=None, frames=None, timeout_s=None, quiet=True)
    intake = SimpleNamespace(next=silence, silent=None, unusable=None)
    assert not record._go_on(words, recorder, intake, ended)  # type: ignore[arg-type]
    assert disk.bytes == series.size > before
    series.close()


def test_an_end_that_does_not_get_onto_the_disk_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A network's disk says so late: each write went well."""

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    series = Series(tmp_path / "a.mcap", {}, most_bytes=1)
    monkeypatch.setattr(sinks, "os", _with(os, fsync=full))
    for number in range(3):
        series.add(WIRE, os.urandom(300), number, number)
    with pytest.raises(OSError, match="No space left"):
        series.close()
    series.close()  # twice is fine
    assert sum(1 for path in series.files for _ in Recording(path).entries({WIRE.topic})) == 3


@pytest.mark.parametrize("bounds", [{}, {"most_bytes": 25_000}, {"most_s": 0.37}], ids=["one", "bytes", "age"])
def test_what_came_more_than_three_tenths_of_a_second_ago_is_in_the_files_whenever_it_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, items: list[Any], bounds: dict[str, Any]
) -> None:
    """A kill leaves what is in the files; they are read at the last moment before each step of the clock ends."""
    now_s, rng, stop = [0.0], random.Random(3), record._Stop()
    waiting = sorted(items[:220], key=lambda one: not isinstance(one, SkinState))  # no file before the first state
    came_s: dict[int, float] = {}
    missing: list[int] = []

    def opener(head: dict[str, str]) -> Series:
        return Series(tmp_path / "a.mcap", head, now_s=lambda: now_s[0], **bounds)

    recorder = Recorder(opener, RecorderOptions())

    def pass_(step_s: float) -> None:
        now_s[0] += step_s
        files = [] if recorder.series is None else recorder.series.files
        there = [entry.sequence for path in files for entry in Recording(path).entries({WIRE.topic})]
        missing.append(len(came_s) - len(there))
        late = {number for number, at_s in came_s.items() if at_s < now_s[0] - LATE_S}
        assert late <= set(there), f"at {now_s[0]:.3f} s"

    pause_s = [0.0]

    def next_one(timeout_s: float) -> object | None:
        if pause_s[0] > timeout_s or not waiting:
            pause_s[0] -= timeout_s
            pass_(timeout_s)
            stop.asked = not waiting and not missing[-1]
            return None
        pass_(pause_s[0])
        found = waiting.pop(0)
        if isinstance(found, WireFrame):
            came_s[found.n] = now_s[0]
            pause_s[0] = 0.005 if len(came_s) < STEADY else rng.choice([0.005, 0.005, 0.02, 0.1, 0.24, 0.26, 1.1])
        else:
            pause_s[0] = 0.0
        return found

    monkeypatch.setattr(record, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    words = SimpleNamespace(seconds=None, frames=None, timeout_s=None, quiet=True)
    intake = SimpleNamespace(next=next_one, silent=None, unusable=None)
    with contextlib.closing(recorder):
        assert not record._go_on(words, recorder, intake, stop)  # type: ignore[arg-type]
    assert recorder.series is not None
    assert (len(recorder.series.files) > 3) == bool(bounds)
    assert len(came_s) == recorder.frames > STEADY + 20
    assert max(missing) > 1, "some wait in memory for a while"


def test_on_a_terminal_a_line_says_each_second_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [0.0]
    series = SimpleNamespace(files=["day.mcap"], size=0, path="day.mcap", sync=lambda: None, due_s=0.0)
    stream: Any = SimpleNamespace(frames=0, missed=0, recorded_s=0.0, full=False, series=series)

    def take(_: object) -> None:
        stream.frames += 1
        stream.recorded_s, series.size = 0.1 * stream.frames, 100_000 * stream.frames

    def next_one(timeout_s: float) -> object | None:
        now_s[0] += 0.1
        return stream if now_s[0] < 3.05 else None

    stream.take = take
    ours, theirs = pty.openpty()
    with open(theirs, "w", buffering=1) as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        monkeypatch.setattr(record, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
        words = SimpleNamespace(seconds=None, frames=None, timeout_s=3.0, quiet=False)
        intake = SimpleNamespace(next=next_one, silent=None, unusable=None)
        assert not record._go_on(words, stream, intake, record._Stop())  # type: ignore[arg-type]
        monkeypatch.undo()
        said = ""
        while not said.endswith("\r\n") and select.select([ours], [], [], PATIENCE_S)[0]:
            said += os.read(ours, 1 << 16).decode()
    os.close(ours)
    shown = [line.removesuffix("\x1b[K") for line in said.rstrip().split("\r") if line]
    assert len(shown) >= 5
    assert shown[0].startswith("1.")
    assert "frames, 0 missed, " in shown[0]
    assert shown[0].endswith("MB in day.mcap")
    assert shown[-1].endswith("; nothing comes\x1b[K") or shown[-1].endswith("; nothing comes")
    assert said.endswith("\r\n")


def _with(module: Any, **other: Any) -> Any:
    """Return what stands for a module, some of its names otherwise."""
    return SimpleNamespace(**{**vars(module), **other})
