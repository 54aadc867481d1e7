"""A recording that lacks what its first frames met: those are not computed, and all that rests on others is as ever."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitskin import CloudInUse, Conditions, Frame, SkinState, WireFrame
from eitskin_tools import cli
from eitskin_tools.evaluation.measured_file import load_measured
from eitskin_tools.recording.convert import table_of
from eitskin_tools.recording.replay import Player, ReplayOptions
from eitskin_tools.recording.script import Script
from eitskin_tools.view.film import Film

from .conftest import TINY, Taker, recorded

Items = list[Any]


def without_first(items: Items, kind: type) -> Items:
    """Return all but the first conditions, or cloud, however often they were told."""
    first = next(item.revision for item in items if isinstance(item, kind))
    return [item for item in items if not (isinstance(item, kind) and item.revision == first)]


@pytest.fixture
def first_frames(items: Items) -> int:
    """How many frames met the first conditions."""
    first = next(item.revision for item in items if isinstance(item, Conditions))
    count = sum(item.conditions == first for item in items if isinstance(item, WireFrame))
    assert 0 < count < 150
    return count


@pytest.fixture(params=[Conditions, CloudInUse])
def lacking(request: pytest.FixtureRequest, tmp_path: Path, items: Items) -> Path:
    recorded(tmp_path / "lacks.mcap", without_first(items, request.param))
    return tmp_path / "lacks.mcap"


def test_the_frames_behind_have_all_that_they_met(lacking: Path, items: Items, first_frames: int) -> None:
    script = Script(lacking)
    steps = list(script.steps())
    assert [step.known for step in steps] == [False] * first_frames + [True] * (150 - first_frames)
    assert all(step.conditions is step.cloud is step.reference is None for step in steps[:first_frames])
    begins = steps[first_frames]
    assert begins.conditions is not None
    assert begins.cloud is not None
    assert begins.reference == next(item.reference for item in items if isinstance(item, SkinState))
    assert script.reference() == begins.reference


def test_replay_leaves_it_out_and_says_so(lacking: Path, items: Items, first_frames: int) -> None:
    taker, said = Taker(), []
    with Player(Script(lacking), ReplayOptions(paced=False), bundle=TINY, tell=said.append) as player:
        for _ in player.skin.publish(taker):
            pass
    then = [item for item in items if isinstance(item, Frame)][first_frames:]
    again = [item for item in taker.items if isinstance(item, Frame)]
    assert [one.sequence for one in again] == [one.sequence for one in then]
    assert [one.map.tobytes() for one in again[-40:]] == [
        one.map.tobytes() for one in then[-40:]
    ]  # means of known ones
    assert said == [f"the recording does not say what its first {first_frames} frames met: they are left out"]


def test_arrays_have_every_frame_and_say_of_which_no_cloud_is_known(lacking: Path, first_frames: int) -> None:
    found = table_of(Script(lacking))
    assert (found.columns["cloud_index"] == -1).tolist() == [True] * first_frames + [False] * (150 - first_frames)
    assert len(load_measured(lacking).voltages_V) == 150 - first_frames


@pytest.mark.parametrize("begins", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_each_command_reads_it(
    lacking: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], first_frames: int, *, begins: bool
) -> None:
    ends = ["--publish", f"ipc://{tmp_path}/f", "--control", f"ipc://{tmp_path}/c", "--as-fast-as-possible"]
    part = ["--from", "0" if begins else f"{0.9 * Script(lacking).seconds:.4f}"]
    assert cli.main(["replay", str(lacking), "--bundle", str(TINY), "--quiet", "--json", *part, *ends]) == 0
    sent = json.loads(capsys.readouterr().out)["sent"]
    assert sent == 150 - first_frames if begins else 0 < sent < 150 - first_frames
    assert cli.main(["reinfer", str(lacking), "--bundle", str(TINY), "--json", "--quiet"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["equal"] >= 40  # means of frames that are known
    assert (found["equal"] + found["unknown"], found["differing"]) == (150, {})
    assert cli.main(["convert", str(lacking), "--out", str(tmp_path / "a.npz")]) == 0
    with np.load(tmp_path / "a.npz") as arrays:
        assert len(arrays["voltages_V"]) == 150
    assert cli.main(["doctor", "--electrodes", "--recorded", str(lacking), "--json"]) == 0
    assert "has no reference" not in capsys.readouterr().err
    film = Film(lacking, TINY)
    assert film.part(0)
