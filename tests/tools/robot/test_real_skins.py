"""Supervised processes that are ``eitskin run`` itself, on a virtual skin."""

import subprocess
import sys
import time

import pytest

import eitskin
from eitskin_tools import cli
from eitskin_tools.robot.child import SILENT_S

from .conftest import HERE, PATIENCE_S, Family

TESTS = HERE.parents[1]
BUNDLE = TESTS / "golden" / "tiny.eitskin"


@pytest.fixture
def port():
    words = [sys.executable, TESTS / "runtime" / "skin_process.py", '{"rate_hz": 200}']
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as skin:
        yield skin.stdout.readline().strip()
        skin.terminate()


@pytest.mark.slow
@pytest.mark.process
def test_a_skin_whose_solver_keeps_the_interpreter_is_ended_and_started_again(port, tmp_path):
    words = ["reference", "--port", port, "--bundle", BUNDLE, "--frames", "20", "--out", tmp_path / "ref.json"]
    assert cli.main([*map(str, words), "--force"]) == 0
    skin = {"name": "arm", "port": port, "bundle": BUNDLE, "reference": "ref.json", "restart": "on-failure"}
    program = (sys.executable, TESTS / "tools" / "service" / "hanging_process.py")
    found = Family(tmp_path, [skin], PATIENCE_S, SILENT_S, *program, HANGS_ONCE=str(tmp_path / "hangs"))
    try:
        error = found.until(lambda event: event["event"] == "error")
        assert "ended by signal 6 (Aborted): no sign of life for 10 s: its frame loop stands still" in error["text"]
        said = [event["text"] for event in found.heard if event["event"] == "warning"]
        assert any("hanging_process.py" in line and line.endswith("in hang") for line in said), said
        found.until(lambda event: event["event"] == "ready" and event.get("skin") == "arm")
        control = found.states()["arm"].skin.control
        while eitskin.request(control, "status", timeout_s=PATIENCE_S)["frames"] <= 150:  # past where it hung
            assert found.process.poll() is None
            time.sleep(0.05)
        assert found.states()["arm"].restarts == 1
        found.process.terminate()
        assert found.ended() == 0
    finally:
        found.process.kill()
        found.process.communicate()
