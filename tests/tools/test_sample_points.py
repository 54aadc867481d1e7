"""The sample points are what their module makes, and become the cloud of the sample scene."""

import json

import numpy as np
from tests.golden import make_sample_points as prepare

from eitskin_proto.skin.cloud import align_cloud
from eitskin_proto.skin.cloud_file import load_surface
from eitskin_sim.scene.scene import load_scene
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_tools import cli
from eitskin_tools.command_line import files


def test_the_shipped_points_are_those_that_are_made():
    head, _, body = prepare.SAMPLE.read_bytes().partition(b"end_header\n")
    made_head, _, made_body = prepare.ply(prepare.points()).partition(b"end_header\n")
    assert head == made_head
    found, made = np.frombuffer(body, "<f4"), np.frombuffer(made_body, "<f4")
    assert np.abs(found - made).max() < 1e-3  # another processor rounds otherwise


def test_the_sample_becomes_the_cloud_of_the_sample_scene(tmp_path, capsys):
    out = tmp_path / "cloud.npz"
    assert cli.main(["surface", "sample", "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["points"] == len(prepare.points())
    bend = load_scene(files.find("sample", files.SCENE)).bend
    away = align_cloud(load_surface(out).cloud_mm) - measured_cloud(bend)
    assert np.sqrt((away**2).sum(axis=0).mean()) < 0.5  # mm; the largest error would be of a wrong corner, 100 mm
