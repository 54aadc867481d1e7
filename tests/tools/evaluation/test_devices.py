"""``eitskin evaluate --devices``: a table by mismatch, and one line for whatever is wrong."""

import json
from pathlib import Path

import pytest

from eitskin_sim.evaluation import device_runs as runs
from eitskin_sim.evaluation.mismatch import load_rows
from eitskin_tools import cli
from eitskin_tools.command_line import files
from eitskin_tools.evaluation.devices import KINDS, table


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(runs, "ELEMENT_MM", 4.5)


def words(tmp_path, *more):
    (tmp_path / "devices.json").write_text(json.dumps([{"name": "none"}, {"name": "gauge", "gauge_factor": 1}]))
    few = ["--deformations", "1", "--each", "1", "--draws", "2"]
    return ["evaluate", "--devices", str(tmp_path / "devices.json"), *few, *more]


def test_the_command_prints_one_object(tmp_path, capsys):
    assert cli.main(words(tmp_path, "--trials", "single,press04", "--json")) == 0
    found = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in found["rows"]] == ["none", "gauge"]
    assert [row["single"]["maps"] for row in found["rows"]] == [1, 2]
    assert set(found["bundles"]) == {"single", "press04"}
    assert found["rows"][0]["single"]["cc"] > 0.9
    assert found["rows"][0]["press04"]["gate_missed"] == 0.0


FOREARM = str(Path(__file__).parents[3] / "docs" / "examples" / "skin.toml")


@pytest.mark.slow
def test_devices_of_another_sheet_are_drawn_around_that(tmp_path, capsys):
    more = ("--skin", FOREARM, "--solver", "tikhonov", "--trials", "single,press04", "--json")
    assert cli.main(words(tmp_path, *more)) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["skin"], found["phantoms"]) == ("forearm", "drawn")
    assert found["bundles"] == {"single": None, "press04": None}, "none is shipped: nothing judges, all is touched"
    for row in found["rows"]:
        for trial in ("single", "press04"):
            assert (row[trial]["missed"], row[trial]["gate_missed"]) == (0.0, 0.0)
    assert table(found).startswith("| mismatch | single, CC, rms mm |")


def test_what_goes_by_a_bundle_wants_one_of_the_sheet(tmp_path, capsys):
    assert cli.main(words(tmp_path, "--skin", FOREARM, "--trials", "single", "--solver", "vd2t")) != 0
    error = capsys.readouterr().err
    assert "name a bundle of this skin with --bundle" in error
    assert len(error.splitlines()) == 1


def test_the_shipped_list_is_one():
    rows = load_rows(files.find("single", files.MISMATCHES))
    assert rows[0][0] == "none"
    assert rows[-1][0] == "lab mix"
    assert len(rows) > 30
    assert len(KINDS) == 5


def test_what_cannot_be_run_is_one_line(tmp_path, capsys):
    assert cli.main(words(tmp_path, "--reference", "post")) == 1
    line = capsys.readouterr().err
    assert "--reference post" in line
    assert line.count("\n") == 1
