"""The page about attacks names each, every folder tries its short form, and the command counts what held."""

import json
import re
import sys
from pathlib import Path

import pytest

from . import __main__ as command
from .catalogue import ATTACKS, load
from .outcome import Attack, Effort, Outcome
from .short import SLOW

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "attacks.md"


def test_the_page_names_each_attack_and_no_other() -> None:
    first_table, _ = PAGE.read_text(encoding="utf-8").split("## What must hold")
    assert re.findall(r"^\| ([a-z_-]+\.[a-z_-]+) \|", first_table, re.MULTILINE) == list(ATTACKS)
    assert set(ATTACKS) >= SLOW
    assert all(callable(load(name)) for name in ATTACKS)


def test_every_folder_tries_its_attacks() -> None:
    for folder in {where.split(".")[0] for where in ATTACKS.values()}:
        sources = [path.read_text(encoding="utf-8") for path in (HERE / folder).glob("test_*.py")]
        assert any("short_form(" in source or "Effort()" in source for source in sources), f"no test tries {folder}"


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


@pytest.mark.parametrize(
    ("words", "status", "last"),
    [
        (
            [], 1,
            {
                "attacks": 4, "tried": 7, "withstood": 5, "frames_lost": 6, "broken": ["broken", "lossy", "raising"],
                "seed": 0,
            },
        ),
    ],
)  # fmt: skip
def test_the_last_line_counts_what_was_withstood(words, status, last, monkeypatch, capsys) -> None:
    monkeypatch.setattr(command, "ATTACKS", dict.fromkeys(FAKES, ""))
    monkeypatch.setattr(command, "load", FAKES.__getitem__)
    monkeypatch.setattr(sys, "argv", ["attack", *words])
    assert command.main() == status
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert found | last == found
    assert found["seconds"] >= 0
    lines = {line["attack"]: line for line in map(json.loads, err.splitlines())}
    assert lines["held"]["figures"]["long"]
    assert lines.get("raising", {}).get("broken", ["OSError: no room"]) == ["OSError: no room"]
