"""What a command needs is checked before it starts, and nothing that it imports is left out of the table."""

import re
import tomllib
from pathlib import Path

import pytest

import eitskin
from eitskin_tools import cli
from eitskin_tools.command_line import needs

ROOT = Path(__file__).parents[3]

TOOLS_OF_DEV = {"pytest", "pytest-xdist", "hypothesis", "mypy", "ruff", "scipy-stubs", "build", "coverage"}


def test_every_extra_brings_the_modules_that_the_table_says():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    brought = {}
    for extra in extras.keys() - {"docs", "notebook", "release", "simulators"}:
        names = {re.split(r"[^A-Za-z0-9_-]", text)[0] for text in extras[extra]} - {"eitskin"} - TOOLS_OF_DEV
        brought |= dict.fromkeys(names, extra)
    assert brought == needs.EXTRAS


@pytest.mark.parametrize(
    ("missing", "expected"),
    [
        ("zstandard", "pip install 'eitskin[record]'"),
        ("mcap.reader", "pip install 'eitskin[record]'"),
        ("msgpack", "pip install eitskin"),
    ],
)
def test_a_module_that_is_missed_while_a_command_runs_names_its_extra(monkeypatch, capsys, missing, expected):
    def run(arguments):
        raise ModuleNotFoundError(f"No module named {missing!r}", name=missing)

    monkeypatch.setattr("eitskin_tools.commands.doctor.run", run)
    assert cli.main(["doctor"]) == 1
    assert capsys.readouterr().err == f"eitskin doctor: No module named {missing!r}; install it with: {expected}\n"


@pytest.fixture
def without(monkeypatch):
    """An installation without any extra."""
    monkeypatch.setattr(needs, "find_spec", lambda name: None)


@pytest.mark.usefixtures("without")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            ["bench", "skip"],
            "eitskin bench: bench skip needs scipy: pip install 'eitskin[sim]'",
        ),
        (
            ["train", "--recipe", "tiny", "--data", "x", "--out", "y"],
            "eitskin train: train needs scipy, torch: pip install torch==2.13.0 && pip install 'eitskin[train]' (torch "
            "alone and first: any other way may bring gigabytes of CUDA)",
        ),
        (["view", "day.mcap"], "view day.mcap needs mcap, zstandard: pip install 'eitskin[record]'"),
        (["record", "--out", "day.mcap"], "record needs mcap, zstandard: pip install 'eitskin[record]'"),
        (
            ["plot", "day.mcap", "--out", "day.png"],
            "plot needs mcap, zstandard, matplotlib: pip install 'eitskin[plot,record]'",
        ),
        (["demo"], "eitskin demo: demo needs scipy: pip install 'eitskin[sim]'"),
    ],
)
def test_a_missing_extra_is_one_line_before_anything_starts(capsys, words, expected):
    assert cli.main(words) == 1
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert expected in err


@pytest.mark.parametrize(("words", "least"), [(["virtual-skin"], 524288), (["subscribe"], 262144)])
def test_too_little_memory_for_libraries_that_would_abort_or_wait_forever_is_said(monkeypatch, capsys, words, least):
    monkeypatch.setattr("resource.getrlimit", lambda _: (200_000 << 10, 200_000 << 10))
    assert cli.main(words) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"eitskin {words[0]}: only 195 MB of memory are allowed")
    assert f"'ulimit -v {least}'" in error


@pytest.mark.parametrize("system", ["darwin", "win32"])
def test_on_another_system_a_runtime_says_that_it_needs_linux_in_one_line(monkeypatch, capsys, system):
    monkeypatch.setattr("sys.platform", system)
    assert cli.main(["run", "--port", "COM3"]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"eitskin run: run needs Linux, found {system}: ")
    assert error.count("\n") == 1
    monkeypatch.delitem(vars(eitskin), "Skin", raising=False)
    with pytest.raises(eitskin.SkinError, match=r"^eitskin\.Skin needs Linux"):
        eitskin.Skin  # noqa: B018
