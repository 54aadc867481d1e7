"""What ``eitskin bench gate`` counts, and that it runs on a solved sheet."""

import json

import pytest

from eitskin_tools.bench.gate.bench import FOUND, lines, share
from eitskin_tools.cli import main


def test_a_share_knows_that_presses_of_one_sheet_come_together():
    assert share([True, True, False, False], 2) == {"share": 0.5, "standard_error": 0.5}
    assert share([True, False, True, False], 2) == {"share": 0.5, "standard_error": 0.0}
    assert share([True], 1) == {"share": 1.0, "standard_error": 0.0}


def test_people_read_the_shares_and_the_ideal_observer():
    one = {"share": 0.7, "standard_error": 0.03}
    by = {"1": {}, "5": {"median": 10.9, "lowest_tenth": 7.7, "found": 1.0}}
    found = {
        "flat": False, "sheets": 3, "frames": 5, "snr_db": 52.0, "drift": 0.01, **{name: {"50": one} for name in FOUND},
        "false_alarms": one, "ideal_observer": {"strength_mm2": 50.0, "d_prime": {"drift": by}},
    }  # fmt: skip
    shown = lines(found)
    assert shown[1:4] == [
        "presses of 50 mm2",
        "  seen untouched before: found 70.0% +- 3.0%",
        "  while the sheet moves: found 70.0% +- 3.0%",
    ]
    assert (
        "drift unknown: d' 10.9 median, 7.7 at the worst tenth of places, in 5 frames; would find 100.0%" in shown[-1]
    )
    assert "states no ideal observer" in lines({**found, "ideal_observer": None})[-1]


@pytest.mark.slow  # four sheets are solved
def test_it_runs_on_the_stated_device(capsys):
    assert main(["bench", "gate", "--flat", "--sheets", "1", "--presses", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["found"]["50"]["share"] == found["moving"]["50"]["share"] == 1.0
    assert found["held"]["50"]["share"] > 0.99
    assert found["false_alarms"]["share"] < 0.5
    assert main(["bench", "gate", "--sheets", "0"]) == 2
