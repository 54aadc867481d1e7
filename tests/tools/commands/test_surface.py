"""``eitskin surface``: a file of points in, a cloud that loads again out, or one line."""

import json

import numpy as np
import pytest
from tests.sim.surface.raw_points import BENDS, Raw

from eitskin.reference.plausible import check_prediction
from eitskin_proto.skin.cloud_file import load_surface
from eitskin_proto.skin.sheet_cloud import check_sheet
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.surface.predict import flat_voltages, predict
from eitskin_tools import cli


def test_command_writes_a_cloud_that_loads_again_with_its_prediction(tmp_path, capsys):
    raw = Raw(BENDS["half a turn, stretched"], 8_000)
    np.save(tmp_path / "points.npy", raw.points)
    corner = [f"{value:.2f}" for value in raw.corner()]
    words = ["surface", str(tmp_path / "points.npy"), "--out", str(tmp_path / "cloud.npz"), "--predict", "--json"]
    assert cli.main([*words, "--corner", *corner]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["points"], report["corner"], report["predicted"]) == (8_000, "given", True)
    assert report["size_mm"] == pytest.approx([178.5, 95.7], abs=1.0)
    surface = load_surface(tmp_path / "cloud.npz")
    assert surface.cloud_mm.shape == (3, *PAPER.grid.shape)
    assert np.array_equal(surface.predicted_V, predict(surface.cloud_mm))
    assert np.array_equal(surface.predicted_flat_V, flat_voltages())
    check_prediction(check_sheet(surface.cloud_mm)[0], surface.predicted_V, surface.predicted_flat_V, None)


def test_command_names_the_file_that_is_missing_or_has_too_few_points(tmp_path, capsys):
    np.save(tmp_path / "few.npy", np.random.default_rng(0).uniform(0, 100, (20, 3)))
    for name, text in (("nobody.ply", "no file"), ("few.npy", "found 20 finite points")):
        assert cli.main(["surface", str(tmp_path / name), "--out", str(tmp_path / "cloud.npz")]) == 1
        error = capsys.readouterr().err
        assert name in error
        assert text in error
        assert error.count("\n") == 1
    assert not (tmp_path / "cloud.npz").exists()
