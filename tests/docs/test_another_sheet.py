"""A sheet of 220 x 90 mm with electrodes of its own, from its skin.toml to streamed frames, at tiny size.

The commands are those of docs/build.md and the tutorial. The network learns next to nothing; what is held is that every
step takes what the one before it made, and that frames are of this sheet.
"""

import shutil

import pytest

import eitskin
from eitskin.model.bundle import load_bundle
from eitskin_proto.skin.toml import load
from eitskin_tools.cli import main

from .markdown import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.process]

TINY = (ROOT / "tools/eitskin_tools/recipes/tiny.toml").read_text(encoding="utf-8")
SCENE = """{"touches": [{"disc_mm": [150, 40, 9], "contrast": 0.4}], "element_size_mm": 4}"""
CLI = ("-m", "eitskin_tools.cli")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a folder with skin.toml, a scene and the bundle that was built of the skin."""
    folder = tmp_path_factory.mktemp("forearm")
    shutil.copy(ROOT / "docs/examples/skin.toml", folder / "skin.toml")
    recipe = TINY.replace('skin = "hydrogel"', 'skin = "skin.toml"').replace('touches = "press"', 'touches = "skin"')
    (folder / "recipe.toml").write_text(recipe)
    (folder / "scene.json").write_text(SCENE)
    words = ["build", str(folder / "recipe.toml"), "--out", str(folder / "forearm.eitskin"), "--workers", "1"]
    assert main([*words, "--threads", "1"]) == 0
    return folder


def test_the_bundle_is_of_this_sheet(made):
    bundle, skin = load_bundle(made / "forearm.eitskin"), load(made / "skin.toml")
    assert bundle.skin.digest == skin.digest
    assert bundle.touch_kind == "lower"
    assert bundle.skin.outline.size_mm == (220.0, 90.0)
    assert bundle.tikhonov().shape == (18 * 45, 104)
    assert bundle.manifest["metrics"]["card"]["by_contrast"]


def test_frames_of_this_sheet_are_streamed(made, start):
    bundle, skin, flat = made / "forearm.eitskin", made / "skin.toml", made / "flat.json"
    at = f"ipc://{made}/frames"
    with start(*CLI, "virtual-skin", "--skin", skin, "--scene", made / "scene.json", "--rate", "50") as sheet:
        port = next(word for word in sheet.until("ttySKIN").split() if "ttySKIN" in word)
        with start(*CLI, "reference", "--port", port, "--bundle", bundle, "--out", flat, "--frames", "20") as taken:
            taken.ends()
        words = ["--port", port, "--bundle", bundle, "--reference", flat, "--publish", at]
        with start(*CLI, "run", *words, "--control", f"ipc://{made}/control") as runtime:
            runtime.until("ready publishing")
            with eitskin.subscribe(at, timeout_s=120.0) as frames:
                touched = next(frame for frame in frames if frame.touched and frame.solver != "none")
    assert touched.map.shape == (18, 45)
    assert touched.bundle == load_bundle(bundle).id
    assert 0.0 <= touched.map.min() <= touched.map.max() <= 1.0
