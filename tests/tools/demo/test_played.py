"""What the demonstration plays on: the sheet and the touches that its bundle knows."""

import json
import zipfile
from pathlib import Path

import pytest
from tests.second_skin import SECOND

from eitskin.errors import BundleError, MismatchError
from eitskin.model import bundle as bundles
from eitskin.model import skin_in_use
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import named, to_toml
from eitskin_tools.demo.show import choose, script_of, skin_of, touches_in_words

GOLDEN = Path(__file__).parents[2] / "golden"
TINY, OTHER_SHEET = GOLDEN / "tiny.eitskin", GOLDEN / "second.eitskin"
SAMPLE = Path(bundles.__file__).parents[3] / "tools" / "eitskin_tools" / "scenes" / "sample.json"


@pytest.fixture
def press(tmp_path):
    """A bundle that knows presses, of skin hydrogel, in a folder that could be the shipped one."""
    skin = to_toml(named("hydrogel")).encode()
    with zipfile.ZipFile(TINY) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()} | {"skin.toml": skin}
    manifest = json.loads(parts.pop("manifest.json")) | {"touches": "lower", "skin_digest": named("hydrogel").digest}
    from eitskin_proto.files.digest import sha256_of

    manifest["files"]["skin.toml"] = {"sha256": sha256_of(skin), "bytes": len(skin)}
    path = tmp_path / "press.eitskin"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in {"manifest.json": json.dumps(manifest), **parts}.items():
            archive.writestr(name, data)
    return path


@pytest.fixture
def shipped(monkeypatch, tmp_path):
    """A folder that bundles are shipped in, with one for raising touches."""
    known = bundles.default_path
    for module in (bundles, skin_in_use):
        monkeypatch.setattr(module, "default_path", lambda *kind: tmp_path / known(*kind).name)
    (tmp_path / "free.eitskin").write_bytes(TINY.read_bytes())
    return tmp_path


def test_presses_are_shown_where_a_bundle_knows_them(press, shipped):
    assert choose(None, None) == (shipped / "press.eitskin", "lower")
    assert choose(None, "raise") == (shipped / "free.eitskin", "raise")
    assert choose(press, None) == (press, "lower")
    assert choose(TINY, None) == (TINY, "raise")
    with pytest.raises(MismatchError, match=r"tiny\.eitskin: touches: found raise, expected lower"):
        choose(TINY, "lower")


def test_without_such_a_bundle_the_paper_s_touches_are_shown(shipped):
    assert choose(None, None) == (None, "raise")
    with pytest.raises(BundleError, match="no shipped bundle knows touches that lower"):
        choose(None, "lower")


def test_any_description_of_the_paper_s_sheet_plays_on_the_ideal_one(press):
    assert skin_of(TINY) == PAPER
    pressed = skin_of(press, "lower")
    assert (pressed, pressed.touch_kind) == (PAPER.touched("lower"), "lower")
    assert skin_of(OTHER_SHEET) == SECOND
    with pytest.raises(MismatchError, match="touches: found lower, expected raise"):
        skin_of(press)


def test_the_screen_says_what_touches_do(press):
    assert touches_in_words(script_of(None, TINY, "raise")) == ", where conductance is 50 times as high"
    script = script_of(None, press, "lower")
    assert touches_in_words(script) == ", as of a finger: conductance falls to 40 %"
    assert {touch.factor(1.0) for touch in script.scene_at(3.0).touches} == {0.4}
    assert touches_in_words(script_of(SAMPLE, TINY, "raise")) == ""
