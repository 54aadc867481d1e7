"""A name is that of a shipped file, unless a file here has it; a folder of that name is no file."""

from pathlib import Path

import pytest

from eitskin_proto.skin import toml
from eitskin_tools import cli
from eitskin_tools.command_line import files


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_file_of_that_name_is_ones_own(here):
    (here / "lab").write_text(toml.to_toml(toml.named("hydrogel")))
    assert toml.load("lab") == toml.named("hydrogel")
    (here / "free").touch()
    assert files.find("free", files.BUNDLE) == Path("free")


def refused(capsys, words):
    assert cli.main(words) == 1
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    return err


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["run", "--port=p", "--skin=labb"], "one of the shipped: hydrogel, lab, paper; did you mean 'lab'?"),
        (["run", "--port=p", "--bundle=pres"], "one of the shipped: free, press, units; did you mean 'press'?"),
        (["reference", "--port=p", "--out=o.json", "--skin=papr"], "did you mean 'paper'?"),
        (["reinfer", "f.mcap", "--recorded-bundle=unit"], "did you mean 'units'?"),
        (["bench", "tradeoff", "--phantoms", "paper_mm", "--bundle=fre"], "did you mean 'free'?"),
        (["bench", "tradeoff", "--phantoms=paper_m"], "paper_mm, paper_units; did you mean 'paper_mm'?"),
        (["flash", "write", "fas", "--dry-run"], "fast, full208, idle, paper; did you mean 'fast'?"),
        (["simulate", "sampl", "--out=v.npz"], "did you mean 'sample'?"),
        (["evaluate", "--devices=labb"], "one of the shipped: lab, random, drift, single; did you mean 'lab'?"),
    ],
)
def test_a_name_that_is_nearly_a_shipped_one_is_answered_with_it(capsys, words, expected):
    assert refused(capsys, words).endswith(f"{expected}\n")
