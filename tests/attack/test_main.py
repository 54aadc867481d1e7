"""The last line and the exit status of all attacks together: one that held, one that did not, one that raised."""

import json
import sys

import pytest

from . import __main__ as command
from .outcome import Attack, Effort, Outcome


def held(effort: Effort) -> Outcome:
    return Outcome("held", tried=3, withstood=3, figures={"seed": effort.seed, "long": effort.long})


def broken(effort: Effort) -> Outcome:
    found = Outcome("broken", frames_lost=4)
    found.note(True, "well")
    found.note(False, "it fell over")
    return found


def lossy(effort: Effort) -> Outcome:
    return Outcome("lossy", tried=1, withstood=1, frames_lost=2)


def raising(effort: Effort) -> Outcome:
    raise OSError("no room")


FAKES: dict[str, Attack] = {one.__name__: one for one in (held, broken, lossy, raising)}


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Return a function that runs attacks and gives status, last line, and the lines of each."""
    monkeypatch.setattr(command, "ATTACKS", dict.fromkeys(FAKES, ""))
    monkeypatch.setattr(command, "load", FAKES.__getitem__)

    def run(*words: str):
        monkeypatch.setattr(sys, "argv", ["attack", *words])
        status = command.main()
        out, err = capsys.readouterr()
        return status, json.loads(out), [json.loads(line) for line in err.splitlines()]

    return run


def test_one_that_held_and_one_that_did_not(said):
    status, last, lines = said("--only", "held", "broken", "--seed", "7")
    assert status == 1
    assert list(last) == ["attacks", "tried", "withstood", "frames_lost", "seconds", "broken", "seed"]
    assert last.pop("seconds") >= 0
    assert last == {
        "attacks": 2, "tried": 5, "withstood": 4, "frames_lost": 4, "broken": ["broken"], "seed": 7
    }  # fmt: skip
    assert [line["attack"] for line in lines] == ["held", "broken"]
    assert lines[0]["figures"] == {"seed": 7, "long": True, "seconds": lines[0]["figures"]["seconds"]}
    assert lines[1]["broken"] == ["it fell over"]


def test_all_held(said):
    status, last, lines = said("--only", "held", "--short")
    assert (status, last["broken"], last["tried"]) == (0, [], 3)
    assert lines[0]["figures"]["long"] is False


def test_one_that_costs_frames_or_raises_is_broken_and_the_next_is_tried(said):
    status, last, lines = said()
    assert (status, last["broken"], last["attacks"]) == (1, ["broken", "lossy", "raising"], len(FAKES))
    assert (last["tried"], last["withstood"], last["frames_lost"]) == (7, 5, 6)
    assert lines[3]["broken"] == ["OSError: no room"]
