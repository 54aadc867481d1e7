"""A recipe with [missing_electrodes]: what the legs learned is taught to go on without electrodes, once."""

import tomllib
from pathlib import Path

import pytest

from eitskin.model.bundle import load_bundle
from eitskin_tools.build import recipe as recipes
from eitskin_tools.build import steps
from eitskin_tools.build.recipe import MissingElectrodesWork
from eitskin_tools.build.steps import MISSING_RUN

TINY = (Path(recipes.__file__).parents[1] / "recipes" / "tiny.toml").read_text(encoding="utf-8")
LESSON = "\n[missing_electrodes]\nfitting_steps = 3\nsteps = 2\n"


def test_the_lesson_is_part_of_what_names_a_build() -> None:
    without, found = recipes.parse(tomllib.loads(TINY)), recipes.parse(tomllib.loads(TINY + LESSON))
    assert without.missing_electrodes is None
    assert "missing_electrodes" not in without.as_dict()
    assert found.missing_electrodes == MissingElectrodesWork(fitting_steps=3, steps=2)
    assert found.digest != without.digest
    assert recipes.load("units").missing_electrodes == MissingElectrodesWork()
    with pytest.raises(ValueError, match=r"\[missing_electrodes\]"):
        recipes.parse(tomllib.loads(TINY + "\n[missing_electrodes]\nepochs = 3\n"))


@pytest.mark.slow
@pytest.mark.process
def test_the_last_lesson_is_exported_and_not_done_twice(tmp_path: Path) -> None:
    recipe, told = recipes.parse(tomllib.loads(TINY + LESSON)), []
    steps.make_data(recipe, tmp_path, 1, told.append)
    run = steps.train_legs(recipe, tmp_path, told.append)
    assert run == tmp_path / "runs" / MISSING_RUN
    assert (run / "gate.npz").exists()
    assert "learning to go on without electrodes" in told
    stamp = (run / "best.pt").stat().st_mtime_ns
    assert steps.train_legs(recipe, tmp_path, told.append) == run
    assert (run / "best.pt").stat().st_mtime_ns == stamp
    bundle, _ = steps.export_run(recipe, tmp_path, run, told.append)
    manifest = load_bundle(bundle).manifest
    assert manifest["build"]["missing_electrodes"]["steps"] == 2
    assert manifest["metrics"]["electrodes"]["adapted"]["plan"]["steps"] == 2
