"""The recorder on a file system that is really full: one line, a whole file, and a stream that loses nothing by it."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader

from eitskin import WireFrame
from eitskin.messaging.streams.subscription import subscribe_streams
from eitskin_tools.recording.layout import MAP, WIRE
from eitskin_tools.recording.script import Script
from eitskin_tools.recording.writer import RESERVE_BYTES

from ..test_commands import played
from .small_disk import on_small_disk, unsharing

PATIENCE_S = 120.0
MORE = 100
"""Frames that others take after the recorder's end."""

pytestmark = [
    pytest.mark.process,
    pytest.mark.slow,
    pytest.mark.skipif(unsharing() is None, reason="neither 'unshare -m' nor 'unshare -rm' may mount a tmpfs here"),
]


class Other:
    """Another subscriber to the wire: takes every frame, from before the recorder began until after it ended."""

    def __init__(self, endpoint: str) -> None:
        self._streams = subscribe_streams(endpoint, clouds=False, state=False, conditions=False, timeout_s=PATIENCE_S)
        self.numbers: list[int] = []
        self._more = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        for found in self._streams:
            if isinstance(found, WireFrame):
                with self._more:
                    self.numbers.append(found.n)
                    self._more.notify_all()
            if self._closing:
                return

    def takes_more(self, frames: int) -> None:
        """Wait until so many more have come."""
        with self._more:
            wanted = len(self.numbers) + frames
            assert self._more.wait_for(lambda: len(self.numbers) >= wanted, PATIENCE_S)

    def close(self) -> None:
        self._closing = True
        self._thread.join(PATIENCE_S)
        self._streams.close()


@pytest.fixture
def stream(file: Path, tmp_path: Path) -> Iterator[tuple[str, Other]]:
    with played(file, tmp_path) as endpoint:
        other = Other(endpoint)
        try:
            other.takes_more(1)
            yield endpoint, other
        finally:
            other.close()


def recorded_on(size: int, endpoint: str, folder: Path, *more: str) -> tuple[int, list[str], Path]:
    """Record onto a disk of so many bytes; return the status, the lines that were said, and the folder of files."""
    out = folder / "left"
    words = ["-m", "eitskin_tools.cli", "record", endpoint, "--out", str(folder / "disk" / "a.mcap"), *more]
    command = on_small_disk(size, folder / "disk", out, [sys.executable, *words])
    done = subprocess.run(command, capture_output=True, text=True, timeout=2 * PATIENCE_S, check=False)
    assert done.stdout == ""
    return done.returncode, done.stderr.splitlines(), out


def is_whole(path: Path) -> int:
    """Check that a file has its summary, all that it counts, and no gap; return its frames."""
    script = Script(path)
    assert script.ending == ""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == sum(1 for _ in script.recording.entries())
    numbers = [step.frame.n for step in script.steps()]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    return len(numbers)


@pytest.mark.parametrize("quiet", [(), ("--quiet",)])
def test_the_file_is_whole_the_line_is_one_and_the_stream_loses_nothing(
    stream: tuple[str, Other], tmp_path: Path, quiet: tuple[str, ...]
) -> None:
    endpoint, other = stream
    status, said, left = recorded_on(RESERVE_BYTES + 300_000, endpoint, tmp_path, "--maps", *quiet)
    assert status == 1
    assert len(said) == 1, said
    assert "the disk is full" in said[0]
    (path,) = left.iterdir()
    assert is_whole(path) > 20
    assert str(len(list(Script(path).recording.entries({WIRE.topic})))) + " frames" in said[0]
    assert any(True for _ in Script(path).recording.entries({MAP.topic}))
    other.takes_more(MORE)
    assert other.numbers == list(range(other.numbers[0], other.numbers[0] + len(other.numbers)))


def test_a_disk_without_room_for_the_reserve_is_said_at_once_and_left_empty(
    stream: tuple[str, Other], tmp_path: Path
) -> None:
    endpoint, other = stream
    status, said, left = recorded_on(2 << 20, endpoint, tmp_path)
    assert status == 1
    assert len(said) == 1, said
    assert "less than 8 MB left" in said[0]
    assert list(left.iterdir()) == []
    other.takes_more(MORE)
    assert other.numbers == list(range(other.numbers[0], other.numbers[0] + len(other.numbers)))
