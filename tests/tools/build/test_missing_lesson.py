"""A recipe with [missing_electrodes]: what the legs learned is taught to go on without electrodes, once."""

import tomllib
from pathlib import Path

import pytest

from eitskin_tools.build import recipe as recipes
from eitskin_tools.build.recipe import MissingElectrodesWork

TINY = (Path(recipes.__file__).parents[1] / "recipes" / "tiny.toml").read_text(encoding="utf-8")
LESSON = "\n[missing_electrodes]\nfitting_steps = 3\nsteps = 2\n"


def test_the_lesson_is_part_of_what_names_a_build():
    without, found = recipes.parse(tomllib.loads(TINY)), recipes.parse(tomllib.loads(TINY + LESSON))
    assert without.missing_electrodes is None
    assert "missing_electrodes" not in without.as_dict()
    assert found.missing_electrodes == MissingElectrodesWork(fitting_steps=3, steps=2)
    assert found.digest != without.digest
    assert recipes.load("units").missing_electrodes == MissingElectrodesWork()
    with pytest.raises(ValueError, match=r"\[missing_electrodes\]"):
        recipes.parse(tomllib.loads(TINY + "\n[missing_electrodes]\nepochs = 3\n"))
