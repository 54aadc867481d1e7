"""``eitskin run --config``: what is wrong is one line before anything is started."""

import json
from pathlib import Path

import pytest

from eitskin.robot.config import load_robot
from eitskin_tools import cli
from eitskin_tools.robot.child import command_line_of

GOLDEN = Path(__file__).parents[2] / "golden"
HEAD = 'format = "eitskin-robot"\nversion = 1\n'


@pytest.fixture
def robot(tmp_path):
    """Return what writes a robot.toml of one skin with these lines, and gives its path."""

    def write(*lines, head=HEAD):
        folder = f'folder = "{tmp_path}/sockets"\n' if head == HEAD else ""
        body = '[[skins]]\nname = "left"\nport = "/dev/ttyNONE9"\n'
        (tmp_path / "robot.toml").write_text(head + folder + body + "\n".join(lines))
        return str(tmp_path / "robot.toml")

    return write


def refused(capsys, *words):
    status = cli.main(list(words))
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1, err
    assert "Traceback" not in err
    return status, err


@pytest.mark.parametrize("key", ["bundle", "skin", "reference", "curve_keys"])
def test_a_missing_file_is_named_with_its_skin_and_key(robot, capsys, tmp_path, key):
    status, said = refused(capsys, "run", "--config", robot(f'{key} = "none"'))
    assert status == 1
    assert f"eitskin run: skin left: {key}: no file '{tmp_path}/none'; expected a" in said
    assert not (tmp_path / "sockets").exists()  # nothing was begun


def test_a_bundle_that_is_none_and_a_reference_that_is_none_are_refused(robot, capsys, tmp_path):
    (tmp_path / "bad").write_text("{}")
    for key in ("bundle", "reference", "skin"):
        status, said = refused(capsys, "run", "--config", robot(f'{key} = "bad"'))
        assert status == 1
        assert said.startswith("eitskin run: skin left: ")


def test_a_file_that_is_missing_or_wrong_is_one_line(robot, capsys, tmp_path):
    assert "no file" in refused(capsys, "run", "--config", f"{tmp_path}/none.toml")[1]
    assert "unknown key 'pots'" in refused(capsys, "run", "--config", robot("pots = 3"))[1]
    assert "is it a robot's list" in refused(capsys, "run", "--config", robot(head=""))[1]
    assert "folder" in refused(capsys, "run", "--config", str(tmp_path))[1]


def test_more_electrodes_than_can_be_left_out_are_refused_before_anything_starts(robot, capsys):
    status, said = refused(capsys, "run", "--config", robot(f"exclude_electrodes = {list(range(16))}"), "--check")
    assert status == 1
    assert "skin left: electrodes (0, 1, 2" in said
    assert "expected at most 4" in said


def test_a_look_says_what_would_run_and_opens_nothing(robot, capsys, tmp_path):
    assert cli.main(["run", "--config", robot('bundle = "press"', 'touches = "lower"'), "--check"]) == 0
    assert "left" in capsys.readouterr().out
    path = robot(f'bundle = "{GOLDEN}/tiny.eitskin"', "pose.translation_mm = [1, 2, 3]")
    assert cli.main(["run", "--config", path, "--check"]) == 0
    assert capsys.readouterr().out.startswith(
        f"left: /dev/ttyNONE9 to ipc://{tmp_path}/sockets/left/frames, at 1 2 3 mm"
    )
    assert cli.main(["run", "--config", path, "--check", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["skins"][0]["name"], found["skins"][0]["translation_mm"]) == ("left", [1.0, 2.0, 3.0])
    assert not (tmp_path / "sockets").exists()


def test_every_key_of_the_file_becomes_an_option_that_run_takes(robot):
    path = robot(
        "baud = 115200", 'bundle = "b"', 'skin = "s"', 'touches = "lower"', 'reference = "r"',
        'curve_keys = "k"', 'solver = "tikhonov"', "budget_ms = 5", "every_map = true", "idle_after_s = 2",
        "exclude_electrodes = [1, 2]", "compensate_drift = false", "reconnect_s = 60", "[skins.realtime]",
        "sched_fifo = 5", "affinity = [0, 1]", "mlock = true", "[skins.verify]", 'mode = "always"', "budget_ms = 30",
        "nice = 3", "affinity = [1]", 'cloud = "fitted"',
    )  # fmt: skip
    found = vars(cli._parser("run").parse_args(command_line_of(load_robot(path).skins[0])))
    folder = Path(path).parent
    assert {key: found[key] for key in (
        "port", "baud", "bundle", "skin", "touches", "reference", "curve_keys", "solver", "budget_ms",
        "every_map", "idle_after", "exclude_electrode", "compensate_drift", "reconnect", "sched_fifo",
        "affinity", "mlock", "log_format", "publish", "control", "verify", "verify_budget_ms", "verify_nice",
        "verify_affinity", "cloud",
    )} == {
        "port": "/dev/ttyNONE9", "baud": 115200, "bundle": folder / "b", "skin": folder / "s", "touches": "lower",
        "reference": folder / "r", "curve_keys": folder / "k", "solver": "tikhonov", "budget_ms": 5.0,
        "every_map": True, "idle_after": 2.0, "exclude_electrode": [1, 2], "compensate_drift": False,
        "reconnect": 60.0, "sched_fifo": 5, "affinity": (0, 1), "mlock": True, "log_format": "json",
        "publish": f"ipc://{folder}/sockets/left/frames", "control": f"ipc://{folder}/sockets/left/control",
        "verify": "always", "verify_budget_ms": 30.0, "verify_nice": 3, "verify_affinity": (1,), "cloud": "fitted",
    }  # fmt: skip
    assert "--reference-frames=5" in command_line_of(load_robot(robot("reference_frames = 5")).skins[0])


@pytest.mark.process
def test_a_port_that_is_missing_ends_its_skin_with_the_reason_and_the_last_one_the_run(robot, capfd):
    assert (
        cli.main(["run", "--config", robot(f'bundle = "{GOLDEN}/tiny.eitskin"'), "--json", "--log-format", "json"]) == 1
    )
    out, err = capfd.readouterr()
    (one,) = json.loads(out)["skins"]
    assert (one["name"], one["state"], one["status"]) == ("left", "failed", 1)
    assert "no port /dev/ttyNONE9" in one["why"]
    last = [json.loads(line) for line in err.splitlines() if '"error"' in line][-1]
    assert last["skin"] == "left"
    assert "ended with status 1: no port /dev/ttyNONE9" in last["text"]
