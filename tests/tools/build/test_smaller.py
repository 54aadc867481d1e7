"""A recipe with a smaller network: both are made, one goes into the other, and what does not fit is told at once."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.export.test_pair import made as tiny_bundle

from eitskin.model.bundle import load_bundle
from eitskin_tools.build import making, steps
from eitskin_tools.build import recipe as recipes
from eitskin_tools.build.hours import SMALL_SHARE
from eitskin_tools.build.recipe import BuildRecipe
from eitskin_tools.cli import main

TINY = (Path(recipes.__file__).parents[1] / "recipes" / "tiny.toml").read_text(encoding="utf-8")


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def with_small(small: str) -> str:
    return TINY.replace('network = "tiny"', f'network = "tiny"\nsmall = "{small}"')


def test_the_shipped_recipes_name_recipes_of_their_own_skin_and_touches() -> None:
    for name, network in {"free": "small", "press": "small", "units": "small-units"}.items():
        found = recipes.load(name)
        smaller = found.smaller()
        assert smaller is not None
        assert smaller.network == network
        assert smaller.skin.digest == found.skin.digest
        last = [found.data[one].touches for one in found.training[-1].data or found.data]
        assert {one.touches for one in smaller.data.values()} == set(last)


def test_a_recipe_beside_this_one_may_be_named(tmp_path: Path) -> None:
    written(tmp_path, "other.toml", TINY)
    found = recipes.load(str(written(tmp_path, "large.toml", with_small("other.toml"))))
    assert found.smaller() is not None
    assert found.as_dict()["small"] == "other.toml"
    assert found.digest != recipes.load("tiny").digest
    assert "small" not in recipes.load("tiny").as_dict()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (with_small("other.toml"), "small is 'other.toml', which has a smaller one itself"),
        (TINY.replace("hydrogel", "lab"), "small is 'other.toml': skin found"),
        (TINY.replace('"tiny"\n\n', '"units"\n\n').replace('set = "free"', 'set = "units"'), "labels found units"),
        (None, "no file 'other.toml'"),
    ],
)
def test_what_cannot_be_the_smaller_one_is_told_before_anything_is_made(
    tmp_path: Path, text: str | None, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if text is not None:
        written(tmp_path, "other.toml", text)
    large = written(tmp_path, "large.toml", with_small("other.toml"))
    assert main(["build", str(large), "--out", str(tmp_path / "b.eitskin")]) != 0
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "b.eitskin.build").exists()


def test_both_are_made_and_the_smaller_one_goes_into_the_larger_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []
    sizes = {tmp_path / "work": 8, tmp_path / "work" / "small": 4}

    def whole(
        self: making.Making, recipe: BuildRecipe, work: Path, given: float, *, share: float, **more: Any
    ) -> making.Made:
        asked.append((work, given, share, more.get("presses")))
        larger = more.get("larger")
        assert (larger is not None and larger.is_file()) is (work.name == "small"), "it may begin with the larger one"
        work.mkdir()
        return making.Made(recipe, {}, {"cc": sizes[work]}, tiny_bundle(work / "exported.eitskin", sizes[work]))

    monkeypatch.setattr(making.Making, "whole", whole)
    recipe, out = recipes.load("tiny"), tmp_path / "both.eitskin"
    large, identity = making.with_smaller(
        making.Making(1, lambda _: None, lambda _: None), recipe, recipe, tmp_path / "work", 3.0, out, "some"
    )
    found = load_bundle(out)
    assert found.id == identity
    assert found.bias_width == 8
    assert found.beside == {"small": 4}
    assert found.manifest["metrics"]["card"] == large.card == {"cc": 8}
    assert found.manifest["small"]["metrics"]["card"] == {"cc": 4}
    work = tmp_path / "work"
    assert asked == [(work, 3.0, 1.0 - SMALL_SHARE, "some"), (work / "small", 3.0, SMALL_SHARE, None)]


def test_a_data_set_that_both_have_alike_is_made_once(tmp_path: Path) -> None:
    large, work = recipes.load("tiny"), tmp_path / "work"
    other = replace(large.data["presses"], seed=2)
    small = replace(large, data={"same": large.data["presses"], "other": other})
    (work / "data" / "presses").mkdir(parents=True)
    for _ in range(2):  # a build that goes on finds it shared already
        steps.share_data(small, work / "small", large, work)
    assert [path.name for path in (work / "small" / "data").iterdir()] == ["same"]
    shared = work / "small" / "data" / "same"
    assert shared.resolve() == work / "data" / "presses"
    moved = work.rename(tmp_path / "elsewhere")
    assert (moved / "small" / "data" / "same").resolve() == moved / "data" / "presses", "a folder that is moved"


def test_the_smaller_units_learn_from_what_the_larger_ones_learned_from() -> None:
    large = recipes.load("units")
    small = large.smaller()
    assert small is not None
    assert small.data == large.data
