"""``eitskin card``: what a bundle is worth is printed, and written into a bundle that is else the same."""

import json

import pytest

from eitskin.model.bundle import default_path, load_bundle
from eitskin_sim.evaluation import device_runs as runs
from eitskin_tools import cli
from eitskin_tools.evaluation import card

FEW = ["--deformations", "1", "--each", "1", "--draws", "1"]


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(runs, "ELEMENT_MM", 4.5)
    monkeypatch.setattr(card, "parts", lambda path: ["contrast-50", "mismatch-2"])


@pytest.mark.slow
def test_the_card_goes_into_a_bundle_that_is_else_the_same(tmp_path, capsys):
    out = tmp_path / "with.eitskin"
    assert cli.main(["card", "free", *FEW, "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (contrast,) = found["card"]["by_contrast"]
    assert contrast["contrast"] == 50.0
    assert [row["name"] for row in contrast["rows"]] == ["none", "random"]
    assert contrast["rows"][0]["touch"]["cc"] > 0.9
    assert [row["name"] for row in found["card"]["by_mismatch"]] == ["lab mix"]
    made, shipped = load_bundle(out), load_bundle(default_path("area"))
    assert made.id == found["bundle"] != shipped.id
    assert made.manifest["metrics"]["card"] == found["card"]
    files = [
        {name: file for name, file in one.manifest["files"].items() if name != "skin.toml"} for one in (made, shipped)
    ]
    assert files[0] == files[1]
    assert made.skin == shipped.skin
