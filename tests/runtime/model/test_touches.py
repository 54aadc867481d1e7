"""Which touches a bundle knows, and which bundle is taken for which touches."""

import json
import zipfile

import pytest

from eitskin.errors import BundleError, MismatchError
from eitskin.model import skin_in_use
from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.skin_in_use import bundle_and_skin
from eitskin_proto.skin.toml import named
from eitskin_proto.skin.touch_kind import TOUCH_KINDS


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

    def where(labels="area", touches="raise"):
        return tmp_path / default_path(labels, touches).name

    ship("free.eitskin", "raise")
    monkeypatch.setattr(skin_in_use, "default_path", where)
    return ship


def test_a_bundle_says_which_touches_it_knows_and_an_older_one_knows_raising_ones(tiny, tiny_path, tmp_path):
    assert tiny.touch_kind == "raise"
    for kind in TOUCH_KINDS:
        assert load_bundle(saying(tiny_path, tmp_path / "b.eitskin", kind)).touch_kind == kind
    for wrong in ("press", None, ["raise"]):
        with pytest.raises(BundleError, match=r"touches found .*, expected one of lower, raise, both; .*export"):
            load_bundle(saying(tiny_path, tmp_path / "b.eitskin", wrong))


def test_shipped_bundles_are_found_by_labels_and_touches():
    assert default_path().name == default_path("area", "both").name == "free.eitskin"
    assert default_path("area", "lower").name == "press.eitskin"
    assert default_path("units", "lower").name == "units-press.eitskin"
    with pytest.raises(ValueError, match="touches 'press' do not exist; expected one of lower, raise, both"):
        default_path("area", "press")


def test_a_named_bundle_that_would_miss_the_skin_s_presses_is_refused(shipped, tmp_path):
    shipped("press.eitskin", "lower")
    with pytest.raises(MismatchError, match=r"free\.eitskin: touches: found raise, expected lower, from .* hydrogel"):
        bundle_and_skin(tmp_path / "free.eitskin", named("hydrogel"))
    free = load_bundle(tmp_path / "free.eitskin")
    assert bundle_and_skin(free, named("hydrogel"))[0] is free, "as --touches raise chose it"
    both = named("hydrogel").touched("both")
    assert bundle_and_skin(tmp_path / "free.eitskin", both)[1] is both
    shipped("free.eitskin", "both")
    assert bundle_and_skin(tmp_path / "free.eitskin", named("hydrogel"))[0].touch_kind == "both"


def test_touches_that_are_asked_for_choose_the_bundle_or_are_held_against_it(shipped):
    free, press = shipped("free.eitskin", "raise"), shipped("press.eitskin", "lower")
    assert bundle_and_skin(None, None, "lower")[0].path == press
    assert bundle_and_skin(None, named("hydrogel"), "raise")[0].path == free, "what is asked for decides over the skin"
    assert bundle_and_skin(load_bundle(press), None, "lower")[0].touch_kind == "lower"
    with pytest.raises(MismatchError, match=r"free\.eitskin: touches: found raise, expected lower; name another"):
        bundle_and_skin(load_bundle(free), None, "lower")
    with pytest.raises(ValueError, match="touches 'press' do not exist; expected one of lower, raise, both"):
        bundle_and_skin(None, None, "press")


def test_a_shipped_bundle_is_found_by_its_name_unless_a_file_has_it(tmp_path, monkeypatch):
    assert load_bundle("press", lazily=True).path == default_path("area", "lower")
    assert bundle_and_skin("units", None)[0].labels == "units"
    monkeypatch.chdir(tmp_path)
    (tmp_path / "press").write_bytes(default_path().read_bytes())
    assert load_bundle("press", lazily=True).touch_kind == load_bundle(lazily=True).touch_kind
    with pytest.raises(BundleError, match="no bundle pres; expected a file, or one of the shipped: free, press, units"):
        load_bundle("pres")


@pytest.mark.parametrize(("word", "kind"), [("raising", "raise"), ("lowering", "lower")])
def test_the_words_of_earlier_releases_are_read(tiny_path, tmp_path, word, kind):
    assert load_bundle(saying(tiny_path, tmp_path / "b.eitskin", word)).touch_kind == kind
