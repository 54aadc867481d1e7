"""The command line's contract: what is listed, what is imported when, and what exit status and stderr say."""

import signal
import subprocess
import sys

import pytest

from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER
from eitskin_tools import cli


def said(capsys, *words):
    """Return the status of a command, and what it printed."""
    return cli.main(list(words)), *capsys.readouterr()


@pytest.mark.process
def test_help_imports_no_command():
    code = "import sys; from eitskin_tools.cli import _parser; _parser(None); print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout == "False\n"


def test_help_lists_every_subcommand_below_the_first_steps(capsys):
    status, text, _ = said(capsys, "--help")
    assert status == 0
    listed = [line.split()[0] for line in text.splitlines() if line[:4].isspace() and line[4:5].isalpha()]
    assert listed == list(cli.COMMANDS)
    first = text[text.index("First steps") : text.index("A running skin:")]
    assert all(f"eitskin {name}" in first for name in ("demo", "virtual-skin", "run --port PORT", "subscribe"))
    assert text.index("A running skin:") < text.index("Research and training:")


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_help_fits_a_screen_and_shows_an_example_that_is_understood(capsys, name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    status, text, _ = said(capsys, name, "--help")
    assert status == 0
    assert text.startswith(f"usage: eitskin {name}")
    assert len(text.splitlines()) <= 45
    assert "  eitskin " + cli.COMMANDS[name].example in text
    cli._parser(name).parse_args(cli.COMMANDS[name].example.split())


def test_help_all_has_the_options_that_help_leaves_out(capsys):
    short, long = (said(capsys, "run", option)[1] for option in ("--help", "--help-all"))
    assert "--mlock" in long
    assert "--mlock" not in short
    assert "eitskin run --help-all" in short


def test_what_is_no_command_is_bad_usage(capsys):
    status, _, error = said(capsys)
    assert status == 2
    assert "name a command" in error
    assert said(capsys, "reconstruct") == (2, "", "eitskin: no command 'reconstruct'; 'eitskin --help' lists them\n")


def test_version_prints_the_ids_that_artefacts_carry(capsys):
    assert {PROTOCOL_ID, PAPER.grid_id} <= set(said(capsys, "--version")[1].split())


def test_ctrl_c_is_130_without_a_word(monkeypatch, capsys):
    from eitskin_tools.commands import doctor

    def interrupted(arguments):
        raise KeyboardInterrupt

    def interrupted_while_a_module_loads(arguments):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as error:  # as pybind11 does
            raise ImportError("initialization failed") from error

    for run in (interrupted, interrupted_while_a_module_loads):
        monkeypatch.setattr(doctor, "run", run)
        assert cli.main(["doctor"]) == 130
        assert capsys.readouterr() == ("", "")


def test_a_module_that_finds_no_memory_is_one_line(monkeypatch, capsys):
    def no_memory(name):
        raise ImportError("a page of advice") from ImportError("x.so: failed to map segment")

    monkeypatch.setattr(cli.importlib, "import_module", no_memory)
    assert said(capsys, "skin", "show", "paper") == (
        1,
        "",
        "eitskin: a module cannot be loaded: x.so: failed to map segment; allow more memory, or install it again\n",
    )
