"""The command line's contract: what is listed, what is imported when, and what exit status and stderr say."""

import subprocess
import sys

import pytest

from eitskin_tools import cli

pytestmark = pytest.mark.process


def eitskin(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "eitskin_tools.cli", *words], capture_output=True, text=True, timeout=120, check=False
    )


def test_help_lists_every_subcommand_and_imports_none_of_them() -> None:
    done = eitskin("--help")
    assert done.returncode == 0
    listed = [line.split()[0] for line in done.stdout.splitlines() if line[:4].isspace() and line[4:5].isalpha()]
    assert listed == list(cli.COMMANDS)


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_subcommand_explains_itself(name: str) -> None:
    done = eitskin(name, "--help")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"usage: eitskin {name}")


def test_no_command_is_bad_usage() -> None:
    done = eitskin()
    assert done.returncode == 2
    assert "name a command" in done.stderr


def test_an_unknown_command_is_bad_usage() -> None:
    done = eitskin("reconstruct")
    assert done.returncode == 2
    assert done.stderr == "eitskin: no command 'reconstruct'; 'eitskin --help' lists them\n"


def test_version_prints_the_ids_that_artefacts_carry() -> None:
    from eitskin_proto.sensor.ids import PROTOCOL_ID
    from eitskin_proto.skin.skin import PAPER

    assert {PROTOCOL_ID, PAPER.grid_id} <= set(eitskin("--version").stdout.split())


def test_a_failure_is_one_line_on_stderr_and_exit_1() -> None:
    done = eitskin("simulate", "/nowhere/scene.json", "--out", "/nowhere/v.npz")
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert "/nowhere/scene.json" in done.stderr


def test_the_help_has_two_groups_and_the_first_steps() -> None:
    text = eitskin("--help").stdout
    assert text.index("around a running skin:") < text.index("simulation, training, evaluation:")
    first = text[text.index("first steps") :]
    for name in ("demo", "virtual-skin", "run --port PORT", "subscribe"):
        assert f"eitskin {name}" in first


@pytest.mark.parametrize("columns", [50, 80, 120])
def test_the_help_is_no_wider_than_the_terminal(monkeypatch: pytest.MonkeyPatch, columns: int) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    lines = cli._parser(None).format_help().splitlines()
    assert max(map(len, lines)) <= columns
    steps = lines[lines.index("first steps, without hardware:") :]
    assert "  eitskin virtual-skin      a skin on a port" in "\n".join(steps)


def test_ctrl_c_is_130_without_a_word(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from eitskin_tools.commands import doctor

    def interrupted(arguments: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(doctor, "run", interrupted)
    assert cli.main(["doctor"]) == 130
    assert capsys.readouterr() == ("", "")


def test_importing_the_runtime_pulls_in_neither_torch_nor_scipy() -> None:
    code = (
        "import sys, eitskin; eitskin.subscribe; eitskin.Skin; "
        "print([name for name in ('torch', 'scipy') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.strip() == "[]"
