"""What a command reads is never what it writes."""

from pathlib import Path

import pytest

from eitskin_tools import cli

MINE = "mine"
"""Name of a file that is read, and must stay as it is."""

OVER = {
    "surface": ["surface", MINE, "--out", MINE],
    "simulate --skin": ["simulate", "sample", "--skin", MINE, "--out", MINE],
    "calibrate --surface": ["calibrate", MINE, "--guided", "--port", "/dev/null", "--surface", MINE, "--out", "s.toml"],
    "pair": ["pair", "free", MINE, "--out", MINE],
    "virtual-skin --scene": ["virtual-skin", "--scene", MINE, "--log", MINE],
}
"""One command for each way to name what is read and what is written."""


@pytest.mark.parametrize("command", OVER)
@pytest.mark.parametrize("how", ["as it stands", "by another path", "by a link"])
def test_what_is_read_is_not_written_over(command, how, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path(MINE).write_text("mine alone")
    Path("link").symlink_to(MINE)
    words = list(OVER[command])
    place = max(index for index, word in enumerate(words) if word == MINE)
    words[place] = {"as it stands": MINE, "by another path": f"{tmp_path}/./{MINE}", "by a link": "link"}[how]
    assert cli.main(words) == 2
    assert "is also the input and would be overwritten" in capsys.readouterr().err
    assert Path(MINE).read_text() == "mine alone"


@pytest.mark.parametrize(
    "words",
    [
        ["virtual-skin", "--wire-times", "x.npy", "--log", "./x.npy"],
        ["calibrate", "x.npz", "--guided", "--port", "/dev/null", "--out", "x.npz"],
    ],
)
def test_two_things_are_not_written_to_one_file(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    assert "name the same file" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_bundle_takes_its_own_card(tmp_path, capsys):
    path = tmp_path / "one.eitskin"
    path.write_text("no bundle")
    assert cli.main(["card", str(path), "--out", str(path)]) == 1  # refused for what it holds
    assert "is also the input" not in capsys.readouterr().err
