"""A name is that of a shipped file, unless a file of one's own has it; a folder of that name is no file."""

from pathlib import Path

import pytest

from eitskin_proto.skin import toml
from eitskin_proto.wire import config_toml
from eitskin_tools.build import recipe
from eitskin_tools.command_line import files


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_folder_of_that_name_is_in_nobodys_way(here: Path) -> None:
    """``eitskin dataset --out lab`` makes one, and then ``--skin lab`` is the shipped one as before."""
    for name in ("lab", "paper", "free", "units"):
        (here / name).mkdir()
    assert toml.load("lab") == toml.named("lab")
    assert config_toml.load("paper") == config_toml.named("paper")
    assert files.find("free", files.BUNDLE).is_file()
    assert recipe.load("units").network == "units"
    assert recipe.load("lab").skin == toml.named("lab")


def test_a_file_of_that_name_is_ones_own(here: Path) -> None:
    (here / "lab").write_text(toml.to_toml(toml.named("hydrogel")))
    assert toml.load("lab") == toml.named("hydrogel")
    (here / "free").touch()
    assert files.find("free", files.BUNDLE) == Path("free")
