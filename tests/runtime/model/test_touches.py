"""Which touches a bundle knows, and which bundle is taken for which touches."""

import json
import zipfile

import pytest

from eitskin.errors import BundleError, MismatchError
from eitskin.model import skin_in_use
from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.skin_in_use import bundle_and_skin, knowing
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import named
from eitskin_proto.skin.touch_kind import TOUCH_KINDS, knows, together


def saying(source, path, touches):
    """Write a bundle that says which touches it knows."""
    with zipfile.ZipFile(source) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    manifest = json.loads(parts.pop("manifest.json")) | {"touches": touches}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in {"manifest.json": json.dumps(manifest), **parts}.items():
            archive.writestr(name, data)
    return path


@pytest.fixture
def shipped(tiny_path, tmp_path, monkeypatch):
    """Return what ships a bundle that knows some touches, in a folder that has the raising one alone."""

    def ship(name, touches):
        return saying(tiny_path, tmp_path / name, touches)

    def where(labels="area", touches="raising"):
        return tmp_path / default_path(labels, touches).name

    ship("free.eitskin", "raising")
    monkeypatch.setattr(skin_in_use, "default_path", where)
    return ship


def test_a_bundle_says_which_touches_it_knows_and_an_older_one_knows_raising_ones(tiny, tiny_path, tmp_path):
    assert tiny.touch_kind == "raising"
    for kind in TOUCH_KINDS:
        assert load_bundle(saying(tiny_path, tmp_path / "b.eitskin", kind)).touch_kind == kind
    for wrong in ("press", None, ["raising"]):
        with pytest.raises(BundleError, match=r"touches found .*, expected one of raising, lowering, both; .*export"):
            load_bundle(saying(tiny_path, tmp_path / "b.eitskin", wrong))


def test_shipped_bundles_are_found_by_labels_and_touches():
    assert default_path().name == default_path("area", "both").name == "free.eitskin"
    assert default_path("area", "lowering").name == "press.eitskin"
    assert default_path("units", "lowering").name == "units-press.eitskin"
    with pytest.raises(ValueError, match="touches 'press' do not exist; expected one of raising, lowering, both"):
        default_path("area", "press")


def test_the_skin_s_touches_choose_the_shipped_bundle(shipped):
    with pytest.raises(BundleError, match=r"no shipped bundle knows lowering touches: .*press\.eitskin .*build"):
        bundle_and_skin(None, named("hydrogel"))
    press = shipped("press.eitskin", "lowering")
    for skin, expected in ((named("hydrogel"), "press"), (named("lab"), "free"), (PAPER, "free"), (None, "free")):
        bundle, used = bundle_and_skin(None, skin)
        assert (bundle.path.stem, used.grid_id) == (expected, PAPER.grid_id)
    assert bundle_and_skin(press, PAPER)[1] is PAPER  # a bundle that was named is taken


def test_a_named_bundle_that_would_miss_the_skin_s_presses_is_refused(shipped, tmp_path):
    shipped("press.eitskin", "lowering")
    with pytest.raises(
        MismatchError, match=r"free\.eitskin: touches: found raising, expected lowering, as .* hydrogel"
    ):
        bundle_and_skin(tmp_path / "free.eitskin", named("hydrogel"))
    free = load_bundle(tmp_path / "free.eitskin")
    assert bundle_and_skin(free, named("hydrogel"))[0] is free, "as --touches raise chose it"
    both = named("hydrogel").touched("both")
    assert bundle_and_skin(tmp_path / "free.eitskin", both)[1] is both
    shipped("free.eitskin", "both")
    assert bundle_and_skin(tmp_path / "free.eitskin", named("hydrogel"))[0].touch_kind == "both"


def test_one_bundle_that_knows_both_serves_presses_too(shipped):
    shipped("free.eitskin", "both")
    assert knowing("lowering").path.name == "free.eitskin"


def test_a_named_bundle_that_knows_other_touches_is_refused(shipped, tiny_path):
    with pytest.raises(MismatchError, match=r"tiny\.eitskin: touches: found raising, expected lowering; .*--bundle"):
        knowing("lowering", tiny_path)
    press = shipped("press.eitskin", "lowering")
    assert knowing("lowering", press).path == press
    with pytest.raises(MismatchError, match=r"touches: found lowering, expected raising"):
        knowing("raising", press)


def test_touches_of_several_kinds():
    assert together(["raising", "raising"]) == "raising"
    assert together(["raising", "lowering"]) == together(["both", "raising"]) == "both"
    assert [knows(known, "lowering") for known in TOUCH_KINDS] == [False, True, True]
