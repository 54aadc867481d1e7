"""Options of ``eitskin replay`` and ``eitskin reinfer``: each reaches what it is for."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from eitskin_proto.errors import SkinError
from eitskin_tools import cli
from eitskin_tools.recording.replay.play import Manner
from eitskin_tools.recording.script import Script

from .conftest import TINY


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], Manner()),
        (["--as-fast-as-possible"], Manner(paced=False)),
        (["--speed", "2.5"], Manner(speed=2.5)),
        (["--from", "0.01", "--to", "0.02"], Manner(from_s=0.01, to_s=0.02)),
        (["--loop"], Manner(loop=True)),
    ],
)
def test_replay_plays_in_the_manner_that_was_asked_for(
    file: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], expected: Manner
) -> None:
    found: list[Manner] = []

    def player(script: Script, manner: Manner, **_: Any) -> None:
        found.append(manner)
        raise SkinError("enough")

    monkeypatch.setattr("eitskin_tools.recording.replay.play.Player", player)
    assert cli.main(["replay", str(file), "--quiet", *words]) == 1
    assert found == [expected]


def test_replay_takes_one_pace_only(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["replay", str(file), "--speed", "2", "--as-fast-as-possible"])
    assert ended.value.code == 2
    assert "not allowed with" in capsys.readouterr().err


@pytest.mark.process
@pytest.mark.parametrize("pace", [["--as-fast-as-possible"], ["--speed", "1000"]])
def test_a_part_is_played_to_its_end_and_the_program_ends(file: Path, tmp_path: Path, pace: list[str]) -> None:
    script = Script(file)
    to_s = script.seconds / 2
    done = subprocess.run(
        [sys.executable, "-m", "eitskin_tools.cli", "replay", str(file), "--bundle", str(TINY), "--json", "--quiet",
         "--publish", f"ipc://{tmp_path}/f", "--control", f"ipc://{tmp_path}/c", "--to", f"{to_s:.9f}", *pace],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    expected = sum(1 for _ in script.steps(None, float(f"{to_s:.9f}")))
    assert 0 < found["sent"] == expected < script.frames
    assert found["lost"] == 0


@pytest.mark.process  # matplotlib asks for the system's fonts
def test_reinfer_draws_what_it_computed(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / "maps.png"
    words = ["reinfer", str(file), "--bundle", str(TINY), "--plot", str(picture), "--quiet", "--json"]
    assert cli.main(words) == 0
    assert picture.read_bytes()[:4] == b"\x89PNG"
    found = json.loads(capsys.readouterr().out)
    assert found["equal"] == found["published"] > 0


def test_a_picture_that_cannot_be_written_is_said_before_anything_is_computed(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: Any, **__: Any) -> None:
        raise AssertionError("it was computed")

    monkeypatch.setattr("eitskin_tools.recording.reinfer.session.reinfer", never)
    picture = tmp_path / "nowhere" / "maps.png"
    assert cli.main(["reinfer", str(file), "--bundle", str(TINY), "--plot", str(picture)]) != 0
    said = capsys.readouterr().err
    assert "nowhere" in said
    assert said.count("\n") == 1
