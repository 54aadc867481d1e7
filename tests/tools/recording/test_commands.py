"""The commands: what cannot be used is one line and an exit status; what can is recorded, played and killed."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.runtime.command_line import wait_until_ready

from eitskin.messaging.curve_keys import make_keys
from eitskin_tools import cli
from eitskin_tools.recording.script import Script

from .conftest import TINY

Capture = pytest.CaptureFixture[str]


def one_line(capsys: Capture, *words: str) -> tuple[int, str]:
    """Run a command, and return its status and the one line that it said."""
    status = cli.main(list(words))
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    return status, err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["replay", "a.mcap", "--speed", "0"], "--speed"),
        (["replay", "a.mcap", "--from", "3", "--to", "2"], "--from 3 is not before --to 2"),
        (["reinfer", "a.mcap", "--every", "0"], "--every"),
        (["convert", "a.mcap", "--out", "a.xlsx"], ".parquet"),
        (["convert", "a.mcap", "--out", "a", "--rate", "30"], "--rate and --clock do nothing with rosbag2"),
        (["convert", "a.mcap", "--out", "a", "--lerobot", "--rate", "29.97"], "--lerobot needs --rate HZ, a whole"),
        (["convert", "a.mcap", "b.mcap", "--out", "a.csv"], "several recordings are for --lerobot"),
        (["record", "--out", "a.mcap", "--every", "0"], "--every"),
        (["record", "--out", "a.mcap", "--wire-only", "--maps"], "--wire-only"),
        (["record", "--out", "a.mcap", "--wire-only", "--pictures-hz", "5"], "--wire-only records neither"),
        (["record", "--out", "a.mcap", "--every", "5"], "--every chooses which maps are recorded: it needs --maps"),
        (["record", "--out", "a.mcap", "--pictures-hz", "-1"], "--pictures-hz"),
    ],
)
def test_bad_usage_is_one_line_and_exit_2(capsys: Capture, words: list[str], says: str) -> None:
    status, said = one_line(capsys, *words)
    assert status == 2
    assert says in said


def test_record_does_not_overwrite(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "a.mcap").write_bytes(b"precious")
    status, said = one_line(capsys, "record", "--out", str(tmp_path / "a.mcap"))
    assert status == 2
    assert "already exists" in said
    assert (tmp_path / "a.mcap").read_bytes() == b"precious"


def test_replay_refuses_a_damaged_client_key_before_all_else(tmp_path: Path, capsys: Capture) -> None:
    make_keys(tmp_path / "keys")
    damaged = tmp_path / "keys" / "clients" / "x.key"
    damaged.write_text("no key")
    damaged.chmod(0o600)
    words = ["replay", str(tmp_path / "none.mcap"), "--curve-keys", str(tmp_path / "keys"), "--quiet"]
    assert cli.main(words) == 1
    (named,) = capsys.readouterr().err.splitlines()
    assert named.startswith(f"eitskin replay: {damaged} is not a CURVE key: it holds no public key; copy it")


@contextmanager
def played(file: Path, folder: Path) -> Iterator[str]:
    """Play a recording again and again, in a process of its own."""
    endpoint = f"ipc://{folder}/f"
    process = subprocess.Popen(
        [sys.executable, "-m", "eitskin_tools.cli", "replay", str(file), "--bundle", str(TINY), "--loop",
         "--publish", endpoint, "--control", f"ipc://{folder}/c"],
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        wait_until_ready(process)
        yield endpoint
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=60)


@pytest.mark.process
@pytest.mark.slow
def test_a_stream_is_recorded_until_told_to_stop(file: Path, tmp_path: Path) -> None:
    with played(file, tmp_path) as endpoint:
        out = tmp_path / "b.mcap"
        done = subprocess.run(
            [sys.executable, "-m", "eitskin_tools.cli", "record", endpoint, "--out", str(out), "--frames", "300",
             "--maps", "--json", "--quiet"], capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["missed"], found["dropped"]) == (0, 0)
    script = Script(out)
    assert script.frames == found["frames"] >= 300
    assert not script.recording.cut
    numbers = [step.frame.n for step in script.steps()]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


@pytest.mark.process
def test_where_nobody_publishes_the_recorder_says_so_in_a_line(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "eitskin_tools.cli", "record", f"ipc://{tmp_path}/nobody", "--out",
         str(tmp_path / "a.mcap"), "--timeout-s", "0.5"], capture_output=True, text=True, timeout=120, check=False,
        env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1, done.stderr
    assert "nobody within 0.5 s: no runtime listens there" in done.stderr
    assert not (tmp_path / "a.mcap").exists()
