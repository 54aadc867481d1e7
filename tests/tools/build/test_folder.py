"""The folder of a half-made bundle: it is that bundle's alone, and goes on with the sizes that it began with."""

from dataclasses import replace

import pytest

from eitskin_proto.files.writing import held
from eitskin_tools.build import recipe as recipes
from eitskin_tools.build.folder import OtherBuildError, begin, begun
from eitskin_tools.cli import main

TINY = recipes.load("tiny")
SMALLER = replace(TINY, training=(replace(TINY.training[0], epochs=1),))


def test_another_recipe_skin_or_time_is_refused(tmp_path):
    begin(tmp_path / "b", TINY, TINY, None)
    other_skin = replace(TINY, skin=TINY.skin.touched("both"))
    for asked in (SMALLER, other_skin):
        with pytest.raises(OtherBuildError, match=rf"another recipe or skin: found .*, expected tiny {asked.digest}"):
            begun(tmp_path / "b", asked, None)
    with pytest.raises(OtherBuildError, match=r"begun with --hours None, not 3.0; .*--work"):
        begun(tmp_path / "b", TINY, 3.0)


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "b").mkdir()
    assert begun(tmp_path / "b", TINY, None) is None
    (tmp_path / "b" / "letters.txt").write_text("dear")
    with pytest.raises(OtherBuildError, match="is not the folder of a build; name another with --work"):
        begun(tmp_path / "b", TINY, None)
    for text in ("{", "[]", "{}"):
        (tmp_path / "b" / "build.json").write_text(text)
        with pytest.raises(OtherBuildError, match=r"build\.json is damaged; remove"):
            begun(tmp_path / "b", TINY, None)


def test_two_builds_in_one_folder_are_one_too_many(tmp_path, capsys):
    work = tmp_path / "b.eitskin.build"
    work.mkdir()
    with held(work, "another process makes a bundle there", "wait"):
        assert main(["build", "tiny", "--out", str(tmp_path / "b.eitskin")]) == 1
    said = capsys.readouterr().err
    assert f"{work} is in use: another process is building a bundle there" in said.splitlines()[-1]
    assert not list(work.iterdir())
