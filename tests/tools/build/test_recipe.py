"""Recipes of bundles: what they say, and one line for whatever is wrong with one."""

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from eitskin.model.bundle import load_bundle
from eitskin_proto.skin.toml import named
from eitskin_tools.build import recipe as recipes
from eitskin_tools.build import steps
from eitskin_tools.build.making import FINAL_STAGES_S, Pace, scale, seconds
from eitskin_tools.build.recipe import TrainingStage
from eitskin_tools.build.steps import MISSING_RUN, plan_of
from eitskin_tools.cli import main
from eitskin_tools.command_line import files

TINY = (Path(recipes.__file__).parents[1] / "recipes" / "tiny.toml").read_text(encoding="utf-8")

ROOT = Path(__file__).parents[3]

AGAIN = TINY[TINY.index("[data.presses]") : TINY.index("[[training]]")].replace("presses", "again")
"""The data set once more, by another name."""


def parsed(text):
    return recipes.parse(tomllib.loads(text))


@pytest.mark.parametrize(
    "name", ["free", "free-small", "gentle", "press", "press-small", "tiny", "units", "units-small"]
)
def test_every_shipped_recipe_can_be_planned(name):
    assert name in files.RECIPE.names()
    found = recipes.load(name)
    for one in found.data.values():  # few deformations: hundreds take seconds to draw
        few = replace(one, deformations=1, kept=0, touch_sets=None if one.set == "free" else 2000)
        assert plan_of(found, few).touches == one.touches
    assert found.name == name
    assert recipes.load(name).digest == found.digest


def test_a_recipe_says_skin_data_and_legs():
    found = recipes.load("free")
    assert found.skin == named("lab")
    plans = {name: plan_of(found, replace(one, deformations=1, kept=0)) for name, one in found.data.items()}
    assert (plans["ideal"].skin.name, plans["ideal"].devices, plans["ideal"].touches) == ("lab", "ideal", "hard")
    assert (plans["raise"].skin.name, plans["raise"].devices, plans["raise"].touches) == ("lab", "random", "raise")
    assert [stage.start_from for stage in found.training] == [None]
    assert [stage.start_from for stage in recipes.load("press").training] == ["free"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("epochs = 2", "epoch = 2", r"\[\[training\]\] 1 lacks epochs, .*; is it meant by 'epoch'"),
        ("epochs = 2", "epochs = 2\nnoise = 'N2'", r"noise in \[\[training\]\] 1 is 'N2', expected 'skin' or none"),
        ("epochs = 2", "epochs = 0", r"\[\[training\]\] 1 epochs is 0, expected a whole number from 1 to"),
        ("seed = 4", 'data = ["soft"]', "names data 'soft', known are presses"),
        ("seed = 4", "[[training]]\nepochs = 1\nstart_from = 'free'", "expected it in the first stage only"),
        (
            "seed = 4",
            "network = 'free'",
            "network in .* 1 is 'free', expected one of the same labels as tiny, in a stage",
        ),
        ("seed = 1", "seed = -1", r"\[data.presses\] seed is -1, expected a whole number from 0 to"),
        ("version = 1", "version = 2", "version 2, expected 'eitskin-recipe' version 1"),
        ('set = "free"', 'set = "units"', "set is 'units', network tiny learns from 'free'"),
        ('network = "tiny"', 'network = "huge"', "no recipe is called 'huge'; expected one of"),
        ("[gate]", "[gates]", "unknown key 'gates' in the file; did you mean 'gate'"),
        ("[data.presses]", "[data.'../x']", "a data set is called .*expected letters, digits"),
    ],
)
def test_whatever_is_wrong_with_a_recipe_is_named(old, new, said):
    assert old in TINY
    with pytest.raises(ValueError, match=said):
        parsed(TINY.replace(old, new))


@pytest.mark.parametrize(("text", "found"), [("", "it has no format"), ("format = 'x'", "format is 'x'")])
def test_a_file_that_is_neither_skin_nor_recipe_is_told_of_both(tmp_path, text, found):
    (tmp_path / "f.toml").write_text(text)
    with pytest.raises(ValueError, match=f"{found}, expected 'eitskin-skin', .*, or 'eitskin-recipe', a "):
        recipes.load(str(tmp_path / "f.toml"))


def test_what_would_fail_hours_later_is_refused_at_once(tmp_path, capsys):
    odd = (ROOT / "docs/examples/skin.toml").read_text().replace("[18, 45]", "[20, 44]").replace("[9, 15]", "[10, 11]")
    (tmp_path / "odd.toml").write_text(odd)
    for old, new, said in (
        ('touches = "press"', 'touches = "soft"', "[data.presses] touches 'soft' are unknown"),
        ("epochs = 2", "epochs = 2\nstart_from = 'gone.eitskin'", "gone.eitskin"),
        ("kept = 2", "kept = 0", "the gate has 0 held-out deformations to choose and measure it"),
        ("[[training]]", AGAIN + "[[training]]", "[data.again] and [data.presses] are the same; give one"),
        ("[[training]]", AGAIN + 'skin = "lab"\n[[training]]', "learns from skins hydrogel and lab, in [data.again]"),
        ('"hydrogel"', '"odd.toml"', "a map of 20 x 44 pixels cannot be sharpened"),
    ):
        (tmp_path / "r.toml").write_text(TINY.replace(old, new))
        assert main(["build", str(tmp_path / "r.toml"), "--out", str(tmp_path / "b.eitskin")]) == 1
        out, line = capsys.readouterr()
        assert out == ""
        assert said in line.splitlines()[-1]
        assert not (tmp_path / "b.eitskin.build").exists()


@pytest.mark.slow
def test_hours_scale_deformations_and_epochs_alike():
    small = recipes.load("tiny")
    data = {"presses": replace(small.data["presses"], deformations=30, per_deformation=1000)}
    tiny = replace(small, data=data, training=(TrainingStage(epochs=20),))
    pace = Pace(deformation_s=40.0, sample_s=0.02, trained_s=1e-2)
    whole = seconds(tiny, pace)
    assert scale(tiny, whole / 3600, pace) == tiny
    for hours in (0.4 * whole / 3600, 2.5 * whole / 3600):
        found = scale(tiny, hours, pace)
        assert seconds(found, pace) == pytest.approx(3600 * hours, rel=0.1)
        for name, one in found.data.items():
            share = one.deformations / tiny.data[name].deformations
            assert share == pytest.approx(found.training[0].epochs / tiny.training[0].epochs, rel=0.15)
    with pytest.raises(ValueError, match=r"--hours 0.1 is too little on this machine, expected 0\.\d+ or more"):
        scale(tiny, 0.1, pace)
    assert FINAL_STAGES_S < 3600


LESSON = "\n[missing_electrodes]\nfitting_steps = 3\nsteps = 2\n"
"""What the stages learned is taught to go on without electrodes, once."""


@pytest.mark.slow
@pytest.mark.process
def test_the_last_lesson_is_exported_and_not_done_twice(tmp_path):
    recipe, told = recipes.parse(tomllib.loads(TINY + LESSON)), []
    steps.make_data(recipe, tmp_path, 1, told.append)
    run = steps.train_stages(recipe, tmp_path, told.append)
    assert run == tmp_path / "runs" / MISSING_RUN
    assert (run / "gate.npz").exists()
    assert "training with electrodes missing" in told
    stamp = (run / "best.pt").stat().st_mtime_ns
    assert steps.train_stages(recipe, tmp_path, told.append) == run
    assert (run / "best.pt").stat().st_mtime_ns == stamp
    bundle, _ = steps.export_run(recipe, tmp_path, run, told.append)
    manifest = load_bundle(bundle).manifest
    assert manifest["build"]["missing_electrodes"]["steps"] == 2
    assert manifest["metrics"]["electrodes"]["adapted"]["plan"]["steps"] == 2
