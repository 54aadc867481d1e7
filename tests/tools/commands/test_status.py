"""``eitskin status``: one runtime or all skins of a robot; 0 only where each of them is well."""

import json
from itertools import count

import pytest

from eitskin.messaging.control import ControlServer
from eitskin.robot.config import RobotSkin
from eitskin.robot.described import ProcessState, write_states
from eitskin_tools import cli


class Runtime:
    """Answers ``status``; of each answer the frames have grown by so many."""

    def __init__(self, endpoint, grows=100, **fields):
        self._frames, self._fields = count(0, grows), fields
        self.server = ControlServer(endpoint, self)

    def status(self):
        return {"frames": next(self._frames), "touched": 0, "lost": 0, "corrupt": 0, "trouble": "", **self._fields}


@pytest.fixture
def runtime(tmp_path):
    """Return what starts a runtime that only answers; they end with the test."""
    started = []

    def start(name, **fields):
        (tmp_path / name).mkdir()
        started.append(Runtime(f"ipc://{tmp_path}/{name}/control", **fields))
        return started[-1].server.endpoint

    yield start
    for one in started:
        one.server.close()


def asked(capsys, *words):
    status = cli.main(["status", "--timeout-s", "5", *map(str, words)])
    return status, capsys.readouterr().out


def test_a_runtime_that_goes_on_is_well(runtime, capsys):
    status, said = asked(capsys, runtime("a"))
    assert status == 0
    assert said.startswith("eitskin: ")
    assert "frames/s, untouched, 0 lost, 0 corrupt, all electrodes work" in said


@pytest.mark.parametrize(("fields", "said"), [
    ({"grows": 0}, "no usable frames: the device sends none"),
    ({"grows": 0, "trouble": "stuck"}, "no usable frames: identical rows"),
    ({"trouble": "no signal"}, "no usable frames: no signal"),
])  # fmt: skip
def test_one_that_stands_or_has_no_use_of_its_frames_is_not(runtime, capsys, fields, said):
    status, text = asked(capsys, runtime("a", **fields))
    assert status == 1
    assert said in text


def test_nobody_there_is_said_in_a_line(tmp_path, capsys):
    status = cli.main(["status", f"ipc://{tmp_path}/none", "--timeout-s", "0.1"])
    said = capsys.readouterr().out
    assert status == 1
    assert len(said.splitlines()) == 1
    assert said.startswith("eitskin: no answer from ")


def test_all_skins_of_a_robot_are_asked_and_one_that_fell_is_told_with_its_reason(runtime, tmp_path, capsys):
    left = runtime("left")
    states = (
        ProcessState(RobotSkin("left", "ipc:///l", left), "ready", 17, 2, "ended by signal 9 (Killed)"),
        ProcessState(
            RobotSkin("right", "ipc:///r", f"ipc://{tmp_path}/none"), "failed", 0, 0, "ended with status 1: no port"
        ),
    )
    write_states(tmp_path, 16, states)
    status = cli.main(["status", "--all", str(tmp_path), "--timeout-s", "0.5", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert (status, found["well"], found["of"]) == (1, 1, 2)
    by_name = {one["name"]: one for one in found["skins"]}
    assert by_name["left"]["well"]
    assert by_name["left"]["restarts"] == 2
    assert "restarted 2 times, last because it ended by signal 9" in by_name["left"]["text"]
    assert by_name["right"]["text"] == "failed: ended with status 1: no port"
