"""The recorder on a file system that is really full: one line, and a whole file.

The file system is a tmpfs in a mount namespace of its own, which goes with the last process in it: nothing is left,
whatever ends the test.
"""

import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from mcap.reader import make_reader

from eitskin_tools.recording.layout import MAP
from eitskin_tools.recording.script import Script
from eitskin_tools.recording.writer import RESERVE_BYTES

from .test_commands import played

INSIDE = 'mount -t tmpfs -o size="$1" small "$2" || exit 99; out="$3"; disk="$2"; shift 3; "$@"; found=$?; '
INSIDE += 'cp -a "$disk/." "$out" || exit 98; exit $found'
"""The rest is a command; its status is the status."""


@cache
def unsharing() -> list[str] | None:
    """Return the command that lets a process mount for itself, or None where neither way is permitted."""
    if shutil.which("unshare") is None:
        return None
    for options in ("-m", "-rm"):
        command = ["unshare", options]
        probe = [*command, "mount", "-t", "tmpfs", "-o", "size=64k", "probe", "/mnt"]
        if subprocess.run(probe, capture_output=True, timeout=60, check=False).returncode == 0:
            return command
    return None


pytestmark = [
    pytest.mark.process,
    pytest.mark.slow,
    pytest.mark.skipif(unsharing() is None, reason="neither 'unshare -m' nor 'unshare -rm' may mount a tmpfs here"),
]


@pytest.mark.parametrize(("size", "says"), [(RESERVE_BYTES + 300_000, "the disk is full"), (2 << 20, "less than 8 MB")])
def test_a_full_disk_is_one_line_and_the_file_is_whole(file: Path, tmp_path: Path, size: int, says: str) -> None:
    disk, left = tmp_path / "disk", tmp_path / "left"
    disk.mkdir()
    left.mkdir()
    command = unsharing()
    assert command is not None
    with played(file, tmp_path) as endpoint:
        words = ["record", endpoint, "--out", str(disk / "a.mcap"), "--maps"]
        done = subprocess.run(
            [*command, "sh", "-c", INSIDE, "sh", str(size), str(disk), str(left),
             sys.executable, "-m", "eitskin_tools.cli", *words],
            capture_output=True, text=True, timeout=240, check=False,
        )  # fmt: skip
    (said,) = done.stderr.splitlines()
    assert (done.returncode, done.stdout, says in said) == (1, "", True), said
    if size < RESERVE_BYTES:
        assert list(left.iterdir()) == []
        return
    (path,) = left.iterdir()
    script = Script(path)
    numbers = [step.frame.n for step in script.steps()]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert f"{len(numbers)} frames" in said
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == sum(1 for _ in script.recording.entries())
    assert any(True for _ in script.recording.entries({MAP.topic}))
    assert script.ending == ""
