"""Options of ``eitskin replay`` and ``eitskin reinfer``: each reaches what it is for."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from eitskin.model.bundle import default_path, load_bundle
from eitskin_tools import cli
from eitskin_tools.recording.script import Script

from .conftest import TINY, recorded_off

Capture = pytest.CaptureFixture[str]


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


def test_reinfer_says_how_many_maps_are_bit_equal(file: Path, capsys: Capture) -> None:
    assert cli.main(["reinfer", str(file), "--bundle", str(TINY), "--quiet"]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[1:] == ["150 of 150 published maps are bit-equal"]
    assert out.startswith("150 frames, 0 of them withheld, in ")
    assert err == ""


def test_reinfer_ends_with_1_where_a_map_is_off_and_says_by_what_and_where(
    tmp_path: Path, items: list[Any], capsys: Capture
) -> None:
    seq = recorded_off(tmp_path / "a.mcap", items)
    words = ["reinfer", str(tmp_path / "a.mcap"), "--bundle", str(TINY), "--quiet"]
    assert cli.main(words) == 1
    said = f"149 of 150 published maps are bit-equal; differing: 1 by map, first at frame {seq}"
    assert capsys.readouterr().out.splitlines()[1:] == [said]
    assert cli.main([*words, "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert (found["equal"], found["published"]) == (149, 150)
    assert (found["differing"], found["first_differing"]) == ({"map": 1}, seq)


def test_reinfer_compares_another_bundle_with_the_one_that_is_named_as_running(short: Path, capsys: Capture) -> None:
    other = default_path()
    words = ["reinfer", str(short), "--recorded-bundle", str(TINY), "--bundle", str(other), "--quiet"]
    assert cli.main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["bundle"], found["other_bundle"]) == (load_bundle(TINY).id, load_bundle(other, lazily=True).id)
    assert found["as_recorded"] is True
    assert found["against_recorded"]["frames"] == 45
    assert cli.main(words) == 0
    (said,) = capsys.readouterr().out.splitlines()[1:]
    assert said.startswith("compared with the recorded bundle in 45 frames: ")


def test_reinfer_without_the_bundle_that_ran_says_that_it_compares_with_nothing(short: Path, capsys: Capture) -> None:
    words = ["reinfer", str(short), "--bundle", str(default_path()), "--quiet"]
    assert cli.main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["as_recorded"] is False
    assert not {"equal", "against_recorded", "other_bundle"} & set(found)
    assert cli.main(words) == 0
    (said,) = capsys.readouterr().out.splitlines()[1:]
    assert said == "not compared: name the bundle of the recording with --recorded-bundle"
