"""``eitskin dataset`` and ``eitskin bench``: usage, refusals and one object on stdout."""

import json

import pytest

from eitskin_tools import cli


def test_a_folder_with_other_things_is_exit_1_in_one_line(capsys, tmp_path):
    (tmp_path / "letter.txt").write_text("x")
    assert cli.main(["dataset", "--set", "paper", "--out", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert "is not empty and is not a data set" in said.err


def test_too_many_touch_sets_is_exit_1_and_writes_nothing(capsys, tmp_path):
    assert cli.main(["dataset", "--set", "paper", "--touch-sets", "99999", "--out", str(tmp_path / "d")]) == 1
    assert "found 99999, expected 10 to 10259" in capsys.readouterr().err
    assert not (tmp_path / "d").exists()


@pytest.mark.slow
@pytest.mark.process
def test_a_small_set_is_written_and_reported_as_one_object(capsys, tmp_path):
    words = ["dataset", "--set", "paper", "--bends", "1", "--touch-sets", "15", "--out", str(tmp_path / "d"), "--json"]
    assert cli.main(words) == 0
    said = capsys.readouterr()
    report = json.loads(said.out)
    assert report["samples"] == report["made"] == 15
    assert report["deformations"] == {"train": 1, "kept": 0, "other": 0}
    assert "15 of 15 samples" in said.err
    assert cli.main(words) == 0
    again = json.loads(capsys.readouterr().out)
    assert (again["digest"], again["made"]) == (report["digest"], 0)
