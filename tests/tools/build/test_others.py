"""A recipe with further networks: all are made for one bundle, and a mistake is reported at once."""

from pathlib import Path

import pytest

from eitskin_sim.freeform.touches import TOUCH_KIND_OF_DRAW
from eitskin_tools.build import recipe as recipes
from eitskin_tools.cli import main

TINY = (Path(recipes.__file__).parents[1] / "recipes" / "tiny.toml").read_text(encoding="utf-8")


def written(folder, name, text):
    path = folder / name
    path.write_text(text)
    return path


def with_other(name, other):
    return TINY.replace('network = "tiny"', f'network = "tiny"\n{name} = "{other}"')


def test_the_shipped_recipes_name_recipes_of_their_own_skin_and_touches():
    for name, networks in {
        "free": {"small": "small", "gentle": "free"}, "press": {"small": "small"}, "units": {"small": "small-units"}
    }.items():  # fmt: skip
        found = recipes.load(name)
        others = found.others()
        assert {one: other.network for one, other in others.items()} == networks
        ways = {TOUCH_KIND_OF_DRAW[found.data[one].touches] for one in found.training[-1].data or found.data}
        for other in others.values():
            assert other.skin.digest == found.skin.digest
            assert {TOUCH_KIND_OF_DRAW[data.touches] for data in other.data.values()} == ways


@pytest.mark.parametrize("name", ["small", "gentle"])
@pytest.mark.parametrize(
    ("text", "said"),
    [
        (with_other("small", "other.toml"), "'other.toml', which has small too"),
        (with_other("gentle", "other.toml"), "'other.toml', which has gentle too"),
        (TINY.replace("hydrogel", "lab"), "'other.toml': skin found"),
        (TINY.replace('"tiny"\n\n', '"units"\n\n').replace('set = "free"', 'set = "units"'), "labels found units"),
        (None, "no file 'other.toml'"),
    ],
)
def test_what_cannot_go_besides_is_told_before_anything_is_made(tmp_path, name, text, said, capsys):
    if text is not None:
        written(tmp_path, "other.toml", text)
    large = written(tmp_path, "large.toml", with_other(name, "other.toml"))
    assert main(["build", str(large), "--out", str(tmp_path / "b.eitskin")]) != 0
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "b.eitskin.build").exists()
