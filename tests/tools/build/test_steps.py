"""What was exported before is taken as it is only where it is whole."""

import json
import shutil
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="bundles are built with the extra 'train'")

from eitskin.model.bundle import load_bundle
from eitskin_tools.build.steps import _exported_before

TINY = Path(__file__).parents[2] / "golden" / "tiny.eitskin"


@pytest.fixture
def exported(tmp_path):
    bundle, said = tmp_path / "exported.eitskin", tmp_path / "exported.json"
    shutil.copyfile(TINY, bundle)
    known = {"bundle": load_bundle(bundle).id, "labels": "area", "touches": "raise", "gate": {}}
    said.write_text(json.dumps(known))
    return bundle, said, known


def test_a_whole_bundle_is_not_exported_again(exported):
    bundle, said, known = exported
    assert _exported_before(bundle, said) == known


@pytest.mark.parametrize("damage", ["no bundle", "half a bundle", "another bundle", "{}", "[]", "{"])
def test_whatever_is_damaged_is_exported_again(exported, damage):
    bundle, said, known = exported
    if damage == "no bundle":
        bundle.unlink()
    elif damage == "half a bundle":
        bundle.write_bytes(bundle.read_bytes()[:10_000])
    elif damage == "another bundle":
        said.write_text(json.dumps(known | {"bundle": "feed"}))
    else:
        said.write_text(damage)
    assert _exported_before(bundle, said) is None
