"""Texts of devices, files and users reach a terminal with their control characters shown, never as they are."""

import io
from pathlib import Path

import pytest

from eitskin_tools import cli
from eitskin_tools.commands import doctor, flash
from eitskin_tools.console.run_log import RunLog
from eitskin_tools.console.terminal import StatusLine

HOSTILE = "skin\x1b[2J\x1b]0;title\x07\x9b5n\u202eoof\nforged line"


def shown(text: str) -> bool:
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
def test_an_error_shows_what_a_terminal_would_obey(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(words) == 1
    said = capsys.readouterr().err
    assert shown(said)
    assert said.count("\n") == 1


@pytest.mark.parametrize("words", [["bench", HOSTILE], ["run", HOSTILE], ["simulate", f"--{HOSTILE}"]])
def test_bad_usage_shows_it_too(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(words)
    assert shown(capsys.readouterr().err)


def test_a_log_and_a_status_hold_nothing_that_a_terminal_obeys() -> None:
    out = io.StringIO()
    log = RunLog(out)
    log.say(f"device: {HOSTILE}")
    log.status(HOSTILE, {})
    StatusLine(out).above(HOSTILE)
    assert shown(out.getvalue())
    assert out.getvalue().count("\n") == 3


def test_a_device_that_was_found_is_listed_by_what_can_be_printed(capsys: pytest.CaptureFixture[str]) -> None:
    port = {"port": "/dev/ttyACM0", "description": HOSTILE, "id": "1:2", "state": "free"}
    found = {"ports": [port], "usb": [], "bundles": [], "runtimes": [HOSTILE], "limits": [], "problems": [HOSTILE]}
    doctor._print({**found, "device": {"serial_number": HOSTILE}})
    assert shown(capsys.readouterr().out)


def test_a_configuration_s_difference_is_listed_by_what_can_be_printed(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = type("Arguments", (), {"json": False})()
    flash._print(arguments, {"differences": [{"field": "name", "device": HOSTILE, "file": "paper"}], "name": HOSTILE})
    assert shown(capsys.readouterr().out)


def test_a_reference_with_escape_codes_in_its_name_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from tests.attack.files import samples

    path = tmp_path / "r.json"
    path.write_bytes(samples.sealed({**samples.reference(), "serial_number": "\x1b[2Jskin"}))
    assert cli.main(["reference", "--show", str(path)]) == 1
    said = capsys.readouterr().err
    assert shown(said)
    assert "serial_number" in said
