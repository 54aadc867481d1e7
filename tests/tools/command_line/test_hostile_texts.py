"""Texts of devices, files and users reach a terminal with their control characters shown, never as they are."""

import io

import pytest

from eitskin_tools import cli
from eitskin_tools.console.run_log import RunLog
from eitskin_tools.console.terminal import StatusLine

HOSTILE = "skin\x1b[2J\x1b]0;title\x07\x9b5n\u202eoof\nforged line"


def shown(text):
    """Whether every line of a text can be printed as it stands."""
    return all(line.isprintable() for line in text.splitlines()) and "forged line" not in text.splitlines()


@pytest.mark.parametrize(
    "words",
    [
        ["simulate", HOSTILE, "--out", "v.npz"],
        ["simulate", "sample", "--out", f"{HOSTILE}/v.npz"],
        ["reference", "--show", HOSTILE],
        ["flash", "write", HOSTILE, "--dry-run"],
        ["run", "--port", "/dev/null", "--bundle", HOSTILE],
        ["surface", HOSTILE, "--out", "c.npz"],
    ],
    ids=lambda words: f"{words[0]} {words[-1][:4]}",
)
def test_an_error_shows_what_a_terminal_would_obey(words, capsys):
    assert cli.main(words) == 1
    said = capsys.readouterr().err
    assert shown(said)
    assert said.count("\n") == 1


@pytest.mark.parametrize("words", [["bench", HOSTILE], ["run", HOSTILE], ["simulate", f"--{HOSTILE}"]])
def test_bad_usage_shows_it_too(words, capsys):
    assert cli.main(words) == 2
    assert shown(capsys.readouterr().err)


def test_a_log_and_a_status_hold_nothing_that_a_terminal_obeys():
    out = io.StringIO()
    log = RunLog(out)
    log.say(f"device: {HOSTILE}")
    log.status(HOSTILE, {})
    StatusLine(out).above(HOSTILE)
    assert shown(out.getvalue())
    assert out.getvalue().count("\n") == 3
