"""A recording while it is made: what is forced onto the disk, and the line that says how far it is."""

import os
import pty
import select
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from eitskin_tools.commands.recorded import record
from eitskin_tools.recording import sink as sinks
from eitskin_tools.recording.layout import WIRE
from eitskin_tools.recording.series import Series

PATIENCE_S = 60.0


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
    intake = SimpleNamespace(next=silence, silent=None)
    assert not record._go_on(words, recorder, intake, ended)  # type: ignore[arg-type]
    assert disk.bytes == series.size > before
    series.close()


def test_on_a_terminal_a_line_says_each_second_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [0.0]
    series = SimpleNamespace(files=["day.mcap"], size=0, path="day.mcap", sync=lambda: None)
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
        intake = SimpleNamespace(next=next_one, silent=None)
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
