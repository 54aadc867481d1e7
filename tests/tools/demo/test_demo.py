"""The demonstration end to end, with a tiny bundle: what is counted and reported, not how fast or how right it is."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from eitskin_tools.scripted_scene.script import demonstration, prepare

pytestmark = pytest.mark.process

ROOT = Path(__file__).parents[3]
BUNDLE = ROOT / "tests" / "golden" / "tiny.eitskin"
COMMAND = [sys.executable, "-m", "eitskin_tools.cli", "demo"]
PATIENCE_S = 120.0
"""How long a busy machine may take for anything here; a quiet one takes seconds."""


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A cache in which the script's keyframes are solved already."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        prepare(demonstration(), demonstration().period_s)
    return folder


def ours(folder):
    """Return the command lines of processes whose temporary files lie in a folder."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                environment = (entry / "environ").read_bytes()
                command = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if f"TMPDIR={folder}\0".encode() in environment and command:
                found.append(command.replace(b"\0", b" ").decode(errors="replace"))
    return found


@pytest.fixture
def place(tmp_path_factory):
    """A temporary folder with a short name: sockets have paths of at most 107 bytes."""
    return tmp_path_factory.mktemp("d")


def left_in(place):
    """What is in the folder that need not be: ``.ses`` is onnxruntime's own."""
    return {path.name for path in place.iterdir()} - {".ses"}


def environment(place, cache):
    return {**os.environ, "TMPDIR": str(place), "XDG_CACHE_HOME": str(cache)}


@pytest.fixture(scope="module")
def shown(cache, tmp_path_factory):
    """Return a demonstration that ran for a while and the temporary folder that it had."""
    place = tmp_path_factory.mktemp("d")
    return demonstrated(3, place, cache), place


def demonstrated(seconds, place, cache):
    return subprocess.run(
        [*COMMAND, f"--seconds={seconds}", "--json", f"--bundle={BUNDLE}"],
        capture_output=True, text=True, timeout=2 * PATIENCE_S, check=False, env=environment(place, cache),
    )  # fmt: skip


def summary(done):
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    found = json.loads(done.stdout)
    return found


def test_json_is_one_object(shown):
    found = summary(shown[0])
    assert found["frames"] > 0, "of 600, if this machine has time for them"
    # A busy machine may lose frames, but each loss is explained: a packet that the line had no room for is cut short
    # and takes its neighbour along, and scans that are long overdue are left out.
    assert found["lost"] <= 2 * found["overruns"] + found["dropped_by_device"]
    assert set(found["latency_us"]) == {"p50", "p99", "p999", "max"}
    assert 0 < found["latency_us"]["p50"] <= found["latency_us"]["p99"] <= found["latency_us"]["max"]
    assert list(found["stages_us"]) == ["wire", "decode", "normalise", "gate", "infer", "pack", "publish", "deliver"]
    medians = [stage["p50"] for stage in found["stages_us"].values()]
    assert all(value >= 0 for value in medians), "stamps of different processes are in order"
    assert 0 <= found["inferred"] < found["frames"]
    assert 0 <= found["scored"] <= found["frames"]


def test_nothing_is_left_behind(shown):
    _, place = shown
    assert ours(place) == []
    assert left_in(place) == set()


def test_a_process_that_dies_ends_the_demonstration_with_one_line(place, cache):
    broken = place / "broken.eitskin"
    broken.write_bytes(BUNDLE.read_bytes()[:5000])
    done = subprocess.run(
        [*COMMAND, "--seconds=3", "--json", f"--bundle={broken}"],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False, env=environment(place, cache),
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert "broken.eitskin" in done.stderr
    assert ours(place) == []
    assert left_in(place) == {"broken.eitskin"}


@pytest.mark.slow
def test_ctrl_c_ends_it_early_with_its_summary(place, cache):
    process = subprocess.Popen(
        [*COMMAND, "--seconds=900", f"--bundle={BUNDLE}"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment(place, cache),
    )  # fmt: skip
    assert any("the first frame is here" in line for line in process.stderr)
    process.send_signal(signal.SIGINT)
    try:
        out, error = process.communicate(timeout=PATIENCE_S)  # well before the 900 s that it was started for
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 0, error
    assert "latency, wire to subscriber" in out
    assert ours(place) == []
    assert left_in(place) == set()
