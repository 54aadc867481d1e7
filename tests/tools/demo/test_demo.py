"""The demonstration end to end, with a tiny bundle: what is counted and reported, not how fast or how right it is."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import pytest

from eitskin_tools.demo import show
from eitskin_tools.processes.children import Child, ChildDiedError, process_group
from eitskin_tools.scripted_scene.script import demonstration, prepare

pytestmark = pytest.mark.process

ROOT = Path(__file__).parents[3]
BUNDLE = ROOT / "tests" / "golden" / "tiny.eitskin"
COMMAND = [sys.executable, "-m", "eitskin_tools.cli", "demo", "--no-draw"]
PATIENCE_S = 120.0
"""How long a busy machine may take for anything here; a quiet one takes seconds."""


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache in which the script's keyframes are solved already."""
    folder: Path = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        prepare(demonstration(), demonstration().period_s)
    return folder


def ours(folder: Path) -> list[str]:
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
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A temporary folder with a short name: sockets have paths of at most 107 bytes."""
    return tmp_path_factory.mktemp("d")


def left_in(place: Path) -> set[str]:
    """What is in the folder that need not be: ``.ses`` is onnxruntime's own."""
    return {path.name for path in place.iterdir()} - {".ses"}


def environment(place: Path, cache: Path) -> dict[str, str]:
    return {**os.environ, "TMPDIR": str(place), "XDG_CACHE_HOME": str(cache)}


@pytest.fixture(scope="module")
def shown(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[subprocess.CompletedProcess[str], Path]:
    """Return a demonstration that ran for a while and the temporary folder that it had."""
    place = tmp_path_factory.mktemp("d")
    return demonstrated(3, place, cache), place


def demonstrated(seconds: int, place: Path, cache: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, f"--seconds={seconds}", "--json", f"--bundle={BUNDLE}"],
        capture_output=True, text=True, timeout=2 * PATIENCE_S, check=False, env=environment(place, cache),
    )  # fmt: skip


def summary(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_json_is_one_object(shown: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    found = summary(shown[0])
    assert found["frames"] > 0, "of 600, if this machine has time for them"
    # A machine that is too busy to read in time may lose frames, but each loss is explained: a packet that the line had
    # no room for is cut short and takes its neighbour along.
    assert found["lost"] <= 2 * found["overruns"]
    assert set(found["latency_us"]) == {"p50", "p99", "p999", "max"}
    assert 0 < found["latency_us"]["p50"] <= found["latency_us"]["p99"] <= found["latency_us"]["max"]
    assert list(found["stages_us"]) == ["wire", "decode", "normalise", "gate", "infer", "pack", "publish", "deliver"]
    medians = [stage["p50"] for stage in found["stages_us"].values()]
    assert all(value >= 0 for value in medians), "stamps of different processes are in order"
    assert 0 <= found["inferred"] < found["frames"]
    assert 0 <= found["scored"] <= found["frames"]


@pytest.mark.slow
def test_a_sheet_of_another_size_is_played_scanned_and_shown(place: Path, cache: Path) -> None:
    """As long a demonstration as it takes: on a busy machine a scan is late for a short one."""
    scene = ROOT / "docs" / "examples" / "scene.json"
    for seconds in (2, 8, 32, 128):
        done = subprocess.run(
            [*COMMAND, f"--seconds={seconds}", "--json", f"--bundle={BUNDLE.with_name('second.eitskin')}",
             f"--scene={scene}"],
            capture_output=True, text=True, timeout=seconds + 2 * PATIENCE_S, check=False,
            env=environment(place, cache),
        )  # fmt: skip
        found = summary(done)
        assert found["frames"] > 0
        if found["clouds"] > 0:
            break
    assert found["clouds"] > 0, "the scanner's clouds have the pixels of that sheet"


@pytest.mark.slow
def test_a_longer_demonstration_computes_and_scores_what_it_shows(place: Path, cache: Path) -> None:
    found = summary(demonstrated(20, place, cache))
    assert found["frames"] >= 200, "of 4000: also a busy machine has time for these"
    assert found["scored"] > 50
    assert 0 < found["inferred"] < found["frames"]
    assert -1.0 <= found["cc_median"] <= 1.0


def test_nothing_is_left_behind(shown: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    _, place = shown
    assert ours(place) == []
    assert left_in(place) == set()


def test_a_process_that_dies_ends_the_demonstration_with_one_line(place: Path, cache: Path) -> None:
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
def test_ctrl_c_ends_it_early_with_its_summary(place: Path, cache: Path) -> None:
    process = subprocess.Popen(
        [*COMMAND, "--seconds=900", "--json", f"--bundle={BUNDLE}"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment(place, cache),
    )  # fmt: skip
    deadline = time.monotonic() + PATIENCE_S
    while not any("first" in path.read_text() for path in place.glob("eitskin-demo-*/subscriber.out")):
        assert time.monotonic() < deadline, "no frame has come"
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    try:
        out, error = process.communicate(timeout=PATIENCE_S)  # well before the 900 s that it was started for
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 0, error
    assert json.loads(out)["frames"] > 0
    assert ours(place) == []
    assert left_in(place) == set()


@pytest.mark.slow
@pytest.mark.parametrize("after_first", [False, True])
def test_ctrl_c_while_it_starts_is_the_first_frame_s_to_decide(
    place: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, after_first: bool
) -> None:
    """What starts last is still to come when the first frame may be there already."""

    def interrupted(options: show.Options, control: str, folder: Path, scene: list[str]) -> Child:
        deadline = time.monotonic() + PATIENCE_S
        while after_first and show.FIRST not in (folder / "subscriber.out").read_text():
            assert time.monotonic() < deadline, "no frame has come"
            time.sleep(0.05)
        raise KeyboardInterrupt

    for name, value in environment(place, cache).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    monkeypatch.setattr(show, "_scanner", interrupted)
    options = show.Options(seconds=900.0, bundle=BUNDLE)
    if after_first:
        assert show.summarise(options, show.stream(options))["frames"] > 0
    else:
        with pytest.raises(KeyboardInterrupt):
            show.stream(options)
    assert ours(place) == []
    assert left_in(place) == set()


@pytest.mark.parametrize("arguments", [["--seconds=0"], ["--rate=-5"], ["--noise=N9"], ["--solver=magic"]])
def test_bad_usage_is_exit_2(arguments: list[str]) -> None:
    done = subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 2
    assert arguments[0].partition("=")[0] in done.stderr


def test_the_last_words_of_a_dead_child_are_reported(tmp_path: Path) -> None:
    with process_group() as children:
        child = Child("virtual-skin", "eitskin_tools.cli", ["virtual-skin", "--scene=/nowhere.json"], tmp_path)
        children.append(child)
        with pytest.raises(ChildDiedError, match=r"virtual-skin ended with status 1: .*nowhere\.json"):
            child.line(child.out, "{", PATIENCE_S)


def test_children_end_when_their_parent_is_killed(place: Path, cache: Path) -> None:
    code = (
        "import os, pathlib, signal\n"
        "from eitskin_tools.processes.children import Child\n"
        f"child = Child('virtual-skin', 'eitskin_tools.cli', ['virtual-skin'], pathlib.Path({str(place)!r}))\n"
        "child.line(child.out, '/', 120.0)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, timeout=PATIENCE_S, env=environment(place, cache))
    assert done.returncode == -signal.SIGKILL
    deadline = time.monotonic() + PATIENCE_S
    while ours(place) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert ours(place) == []
    assert not list(place.glob("eitskin-*")), "the skin took its port along"


def test_the_demonstration_needs_no_torch() -> None:
    modules = "show, scanner, recorder, score"
    code = (
        f"from eitskin_tools.demo import {modules}\n"
        "from eitskin_tools.virtual_skin import process\n"
        "import eitskin_tools.scripted_scene.script\n"
        "import eitskin_sim.surface.predict, eitskin_sim.evaluation.metrics, sys\n"
        "print('torch' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=PATIENCE_S)
    assert done.stdout == "False\n"
