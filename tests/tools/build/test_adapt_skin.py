"""``eitskin adapt-skin``: a bundle goes on learning on a calibrated sheet, whose ring is no longer even."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eitskin.model.bundle import load_bundle
from eitskin_proto.errors import MismatchError
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.toml import load, named, to_toml
from eitskin_tools.build import adaptation, steps
from eitskin_tools.build.adaptation import Adaptation
from eitskin_tools.build.recipe import CardWork, GateWork
from eitskin_tools.cli import main
from eitskin_tools.command_line import files
from eitskin_training.start import Start

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "skin.toml"
"""A sheet of 220 x 90 mm."""

STATED = named("hydrogel")
RING = STATED.electrodes
OFF_MM = np.random.default_rng(3).uniform(-1.0, 1.0, 16)
TWIN = replace(
    STATED,
    name="forearm",
    calibrated_from=STATED.digest,
    stated_grid_id=STATED.grid_id,
    electrodes=replace(RING, arc_length_mm=Quantity(tuple((STATED.arc_length_mm + OFF_MM).tolist()), "normal", 0.2)),
)


def adapted(name, **work):
    bundle = load_bundle(files.find(name, files.BUNDLE), lazily=True)
    return adaptation.adapted(bundle.path, TWIN, bundle.manifest, bundle.touch_kind, replace(Adaptation(), **work))


@pytest.mark.parametrize(("name", "kind", "touches"), [("press", "free", "press"), ("units", "units", "both")])
def test_it_learns_the_touches_and_labels_that_it_knows_on_devices_of_the_twin(name, kind, touches):
    (data,) = adapted(name).data.values()
    assert (data.set, data.touches, data.devices, data.skin) == (kind, touches, "random", None)
    assert adapted(name).skin == TWIN
    assert adapted(name).name == f"{name} on forearm"
    assert adapted(name, seed=1).digest != adapted(name).digest


def test_a_sheet_of_another_map_is_refused_before_its_data_is_made(monkeypatch):
    fits = adapted("press")
    fits = replace(fits, data={name: replace(one, deformations=2) for name, one in fits.data.items()})
    found = replace(fits, skin=load(EXAMPLE))
    own = steps.fitted_to(found, found.training[0], STATED).architecture
    monkeypatch.setattr(steps, "start_of", lambda *_: Start({}, own, STATED, {}))
    with pytest.raises(MismatchError, match=r"network to start from: map: found 30 x 45 .*, expected 18 x 45 pixels"):
        steps.check(found)
    steps.check(fits)


@pytest.mark.slow
@pytest.mark.process
def test_a_bundle_of_the_twin_comes_out_and_knows_what_it_knew(tmp_path, monkeypatch, capsys):
    small = Adaptation(2, 60, 1, gate=GateWork(0), card=CardWork(1, 1, 1))
    monkeypatch.setattr(adaptation, "Adaptation", lambda: small)
    (tmp_path / "forearm.toml").write_text(to_toml(TWIN))
    words = ["adapt-skin", "press", "--skin", str(tmp_path / "forearm.toml"), "--out", str(tmp_path / "f.eitskin")]
    assert main([*words, "--workers=1", "--threads=1", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    bundle = load_bundle(tmp_path / "f.eitskin")
    assert said["bundle"] == bundle.id
    assert (bundle.touch_kind, bundle.labels, bundle.skin) == ("lower", "area", TWIN)
    assert bundle.manifest["build"]["training"][0]["start_from"] == "press.eitskin"
    assert bundle.manifest["small"]["recipe"]["name"] == "small"
    assert "small_head.onnx" in bundle.files
