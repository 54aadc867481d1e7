"""``eitskin run`` under a supervisor: what it says of itself, and that it ends when its frame loop stands still."""

import json
import os
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.runtime.made_up_skin import virtual_skin

from eitskin_tools.service.watchdog import EXIT_STATUS

HERE = Path(__file__).parent
TESTS = HERE.parents[1]
PATIENCE_S = 60


@contextmanager
def started(*words, **options):
    process = subprocess.Popen(
        [sys.executable, *map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def port():
    with virtual_skin(rate_hz=200) as path:
        yield path


@pytest.fixture
def words(port, tmp_path):
    bundle = TESTS / "golden" / "tiny.eitskin"
    common = ["run", "--port", port, "--bundle", bundle, "--reference-frames", "10"]
    return [*common, "--publish", f"ipc://{tmp_path}/f", "--control", f"ipc://{tmp_path}/c"]


@pytest.mark.process
def test_a_frame_loop_that_stands_still_ends_the_process_with_the_reason_and_the_place(words, tmp_path):
    with started(HERE / "stuck_process.py", *words, "--log-format", "json") as runtime:
        _, said = runtime.communicate(timeout=PATIENCE_S)
    assert runtime.returncode == EXIT_STATUS
    last = json.loads(said.splitlines()[-1])
    assert last["event"] == "error"
    assert last["text"].startswith("the frame loop has stood still for 2 s")
    stacks = "\n".join(last["stacks"])
    assert "stuck_process.py" in stacks
    assert "in stuck" in stacks
    assert list(tmp_path.iterdir()) == []


@pytest.mark.process
def test_a_supervisor_hears_when_it_is_ready_that_it_lives_how_it_is_and_that_it_stops(words, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ear:
        ear.bind(str(tmp_path / "notify"))
        ear.settimeout(PATIENCE_S)
        environment = {**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "400000"}
        with started("-m", "eitskin_tools.cli", *words, "--quiet", env=environment) as runtime:
            heard = []
            while "READY=1" not in heard or heard.count("WATCHDOG=1") < 5 or "frames/s" not in "".join(heard):
                heard.append(ear.recv(1000).decode())
            runtime.terminate()
            while heard[-1] != "STOPPING=1":
                heard.append(ear.recv(1000).decode())
            assert runtime.wait(PATIENCE_S) == 0
    assert any(line.startswith("STATUS=capturing the reference") for line in heard[: heard.index("READY=1")])
    assert any(line.startswith("STATUS=publishing on ipc://") for line in heard)
