"""``eitskin run`` under a supervisor: what it says of itself, and that it ends when its frame loop stands still."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from eitskin_tools.service.watchdog import LIMIT_S, STOOD_STILL

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
    with started(TESTS / "runtime" / "skin_process.py", '{"rate_hz": 200}') as skin:
        yield skin.stdout.readline().strip()
        skin.terminate()
        skin.wait(PATIENCE_S)


@pytest.fixture
def words(port, tmp_path):
    bundle = TESTS / "golden" / "tiny.eitskin"
    common = ["run", "--port", port, "--bundle", bundle, "--reference-frames", "10"]
    return [*common, "--publish", f"ipc://{tmp_path}/f", "--control", f"ipc://{tmp_path}/c"]


@pytest.mark.process
@pytest.mark.parametrize("form", ["text", "json"])
def test_a_frame_loop_that_stands_still_ends_the_process_with_the_reason_and_the_place(words, form, tmp_path):
    with started(HERE / "stuck_process.py", *words, "--log-format", form) as runtime:
        _, said = runtime.communicate(timeout=PATIENCE_S)
    assert runtime.returncode == STOOD_STILL
    if form == "json":
        last = json.loads(said.splitlines()[-1])
        assert last["event"] == "error"
        assert last["text"].startswith("the frame loop has stood still for 2 s")
        said = "\n".join(last["stacks"])
    else:
        assert "eitskin run: the frame loop has stood still for 2 s" in said
    assert "stuck_process.py" in said
    assert "in stuck" in said
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


@pytest.mark.process
def test_a_supervisor_hears_nothing_once_c_code_keeps_the_interpreter(words, tmp_path):
    every_s = 0.4
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ear:
        ear.bind(str(tmp_path / "notify"))
        ear.settimeout(PATIENCE_S)
        environment = {
            **os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": f"{every_s * 1e6:.0f}",
            "HANGS_ONCE": str(tmp_path / "hangs"), "PYTHONFAULTHANDLER": "1",
        }  # fmt: skip
        with started(HERE / "hanging_process.py", *words, env=environment) as runtime:
            heard = []
            while "READY=1" not in heard or "WATCHDOG=1" not in heard[heard.index("READY=1") :]:
                heard.append(ear.recv(1000).decode())
            while not (tmp_path / "hangs").exists():
                assert runtime.poll() is None
                time.sleep(0.01)
            time.sleep(every_s)  # a sign may have been on its way
            ear.setblocking(False)
            with suppress(BlockingIOError):
                while True:
                    ear.recv(1000)
            time.sleep(5 * every_s)  # not a wait for something: that nothing comes in so long is what is tried
            with pytest.raises(BlockingIOError):
                ear.recv(1000)
            runtime.send_signal(signal.SIGTERM)  # nobody hears it
            assert runtime.poll() is None
            runtime.send_signal(signal.SIGABRT)  # as systemd's watchdog does
            _, said = runtime.communicate(timeout=PATIENCE_S)
    assert runtime.returncode == -signal.SIGABRT
    assert "Fatal Python error: Aborted" in said
    assert "hanging_process.py" in said
    assert "in hang" in said


@pytest.mark.process
def test_a_process_that_was_stopped_for_longer_than_the_limit_goes_on(words):
    with started("-m", "eitskin_tools.cli", *words) as runtime:
        while not runtime.stderr.readline().startswith("ready "):
            assert runtime.poll() is None
        runtime.send_signal(signal.SIGSTOP)
        time.sleep(LIMIT_S + 1.0)  # not a wait for something: being stopped for so long is what is tried
        runtime.send_signal(signal.SIGCONT)
        assert "frames/s" in runtime.stderr.readline()  # it says that frames were lost meanwhile, or stale
        runtime.terminate()
        runtime.communicate(timeout=PATIENCE_S)
        assert runtime.returncode == 0
