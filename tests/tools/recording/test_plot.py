"""A picture of a recording: it shows what was published, also of a recording that has no maps."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitskin import Frame
from eitskin.model.bundle import load_bundle
from eitskin_tools import cli
from eitskin_tools.recording.plot import MAPS, Course, course_of
from eitskin_tools.recording.script import Script

from .conftest import TINY

pytest.importorskip("matplotlib", reason="pictures need the extra 'plot'")

Capture = pytest.CaptureFixture[str]


def course(path: Path, *span: float) -> Course:
    return course_of(Script(path), load_bundle(TINY), *span)


def plot(path: Path, *words: str) -> int:
    return cli.main(["plot", str(path), "--bundle", str(TINY), "--out", str(path.with_suffix(".png")), *words])


def test_a_picture_is_written_and_its_content_said(file: Path, capsys: Capture) -> None:
    assert plot(file, "--quiet") == 0
    found = course(file)
    touched = sum(count > 0 for count in found.touches)
    seconds, most = Script(file).seconds, max(found.touches)
    said = f"150 frames in {seconds:.1f} s, {touched} of them with touches, at most {most} at once"
    assert capsys.readouterr().out == f"{file.with_suffix('.png')}: {said}\n"
    assert file.with_suffix(".png").read_bytes()[:4] == b"\x89PNG"
    assert plot(file, "--json") == 0
    picture = str(file.with_suffix(".png"))
    assert json.loads(capsys.readouterr().out) == {
        "out": picture, "frames": 150, "touched": touched, "most_touches": most
    }  # fmt: skip


def test_touches_areas_and_drift_are_those_of_the_published_frames(file: Path, items: list[Any]) -> None:
    published, found = [item for item in items if isinstance(item, Frame)], course(file)
    assert len(found.times_s) == len(published)
    assert (found.times_s[0], found.times_s[-1]) == pytest.approx((0.0, Script(file).seconds))
    shown = np.array([frame.map.any() for frame in published])
    areas = np.array(found.areas_mm2)
    assert 20 < (areas > 0).sum() <= shown.sum()
    assert not areas[~shown].any()
    assert len(found.places) == sum(found.touches)
    drifts = [np.nan if frame.drift_percent is None else frame.drift_percent for frame in published]
    np.testing.assert_allclose(found.drifts_percent, drifts)


def test_the_strongest_map_of_each_quarter_is_drawn(file: Path, items: list[Any]) -> None:
    published = [item for item in items if isinstance(item, Frame)]
    found = course(file)
    sums = np.array([frame.map.sum() for frame in published])
    quarters = np.minimum((MAPS * np.array(found.times_s) / found.times_s[-1]).astype(int), MAPS - 1)
    strongest = {k: sums[quarters == k].max() for k in range(MAPS) if sums[quarters == k].any()}
    # A frame that was published with an earlier map may get its own where a part begins.
    assert {k: frame.map.sum() for k, frame in found.strongest.items()} == pytest.approx(strongest, rel=0.05)


def test_a_part_is_drawn_alone_and_one_behind_the_end_is_refused(file: Path, capsys: Capture) -> None:
    whole = course(file).times_s
    found = course(file, whole[50] - 1e-7, whole[99])
    assert found.times_s == whole[50:100]
    assert plot(file, "--from", "200") == 1
    assert "has no frame to draw from 200 s;" in capsys.readouterr().err
    assert not file.with_suffix(".png").exists()
