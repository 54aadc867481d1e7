"""A recipe with networks besides: all are made, they go into one bundle, and what does not fit is told at once."""

from pathlib import Path

import pytest
from tests.export.test_pair import made as tiny_bundle

from eitskin.model.bundle import load_bundle
from eitskin_sim.freeform.touches import WAYS
from eitskin_tools.build import making, steps
from eitskin_tools.build import recipe as recipes
from eitskin_tools.build.making import SHARES
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
        ways = {WAYS[found.data[one].touches] for one in found.training[-1].data or found.data}
        for other in others.values():
            assert other.skin.digest == found.skin.digest
            assert {WAYS[data.touches] for data in other.data.values()} == ways


@pytest.mark.parametrize("name", ["small", "gentle"])
@pytest.mark.parametrize(
    ("text", "said"),
    [
        (with_other("small", "other.toml"), "'other.toml', which has small itself"),
        (with_other("gentle", "other.toml"), "'other.toml', which has gentle itself"),
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


def test_all_are_made_go_into_one_bundle_and_its_card_is_of_all(tmp_path, monkeypatch):
    asked = []
    work = tmp_path / "work"
    sizes = {work: 8, work / "small": 4, work / "gentle": 8}

    def made(self, recipe, folder, given, *, share=1.0, **more):
        asked.append((folder, given, share, more.get("presses")))
        self.tell("data")
        larger = more.get("larger")
        assert larger == (None if folder == work else work / "run"), "it may begin with the larger one"
        folder.mkdir()
        bundle = tiny_bundle(folder / "exported.eitskin", sizes[folder])
        return making.Made(recipe, folder / "run", {}, bundle, load_bundle(bundle).id)

    def card(recipe, folder, bundle, identity, tell):
        assert load_bundle(bundle).id == identity
        return {"cc": sizes[folder], "with": list(load_bundle(bundle).beside)}

    monkeypatch.setattr(making.Making, "made", made)
    monkeypatch.setattr(steps, "make_card", card)
    recipe, out = recipes.load("tiny"), tmp_path / "all.eitskin"
    told = []
    maker = making.Making(1, told.append, lambda _: None)
    large = maker.made(recipe, work, 3.0, share=0.5, presses="some")
    whole = maker.with_others(large, {"small": recipe, "gentle": recipe}, work, 3.0)
    found_card, identity = maker.finished(whole, work, out)
    found = load_bundle(out)
    assert found.id == identity
    assert found.bias_width == 8
    assert found.beside == {"small": 4, "gentle": 8}
    assert found.manifest["metrics"]["card"] == found_card == {"cc": 8, "with": ["small", "gentle"]}
    assert found.manifest["small"]["metrics"]["card"] == {"cc": 4, "with": []}
    assert asked == [
        (work, 3.0, 0.5, "some"), (work / "small", 3.0, SHARES["small"], None),
        (work / "gentle", 3.0, SHARES["gentle"], None),
    ]  # fmt: skip
    assert told == ["data", "small: data", "gentle: data"]
    given = maker.with_others(large, {}, work, 3.0, gentle_of=out)
    assert load_bundle(given.bundle).beside == {"gentle": 8}
    assert load_bundle(given.bundle).id == given.identity


def test_a_time_too_little_for_one_of_them_is_refused_before_any_is_begun(tmp_path, monkeypatch):
    monkeypatch.setattr(making, "measure", lambda *_: making.Pace(1.0, 0.01, 1e-3))
    recipe, work, maker = recipes.load("tiny"), tmp_path / "work", making.Making(1, print, print)
    parts = [(recipe, work, 0.9), (recipe, work / "gentle", 0.1)]
    said = r"--hours 1 is too little for tiny, whose share is 10 %, on this machine, expected 1\.\d+ or more"
    with pytest.raises(ValueError, match=said):
        maker.begin(parts, 1.0)
    assert not work.exists()
    maker.begin(parts, 3.0)
    before = [(folder / "build.json").stat().st_mtime_ns for folder in (work, work / "gentle")]
    maker.begin(parts, 3.0)
    assert [(folder / "build.json").stat().st_mtime_ns for folder in (work, work / "gentle")] == before
