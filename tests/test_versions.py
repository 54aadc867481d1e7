"""The versions that pyproject.toml allows, and those that CI runs the runtime's tests at."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def lines(name):
    """Return the requirements of a constraints file."""
    found = (line.partition("#")[0].strip() for line in (ROOT / name).read_text().splitlines())
    return [line for line in found if line]


def floors(dependencies):
    """Return requirements as the constraint that pins each to its floor."""
    return [re.sub(r"^([A-Za-z0-9-]+)>=", r"\1==", dependency) for dependency in dependencies]


def numbers(version):
    return [int(part) for part in version.split(".")]


def test_ci_installs_exactly_the_floors():
    assert lines("constraints-lowest.txt") == floors(PROJECT["dependencies"])


def test_every_dependency_has_a_floor_and_nothing_else():
    for dependency in PROJECT["dependencies"]:
        assert re.fullmatch(r"[A-Za-z0-9-]+>=[0-9.]+(; python_version (<|>=) '3\.13')?", dependency), dependency
    names = {dependency.partition(">")[0] for dependency in PROJECT["dependencies"]}
    assert names == {
        "numpy", "onnxruntime", "pyserial", "pyusb", "msgpack", "pyzmq", "cobs", "google-crc32c"
    }  # fmt: skip


def test_a_floor_that_drifted_would_be_noticed():
    assert floors(["numpy>=1.26; python_version < '3.13'", "pyusb>=1.2"]) == [
        "numpy==1.26; python_version < '3.13'",
        "pyusb==1.2",
    ]
    assert lines("constraints-lowest.txt") != floors([*PROJECT["dependencies"], "numpy>=1.25"])


def test_what_ci_pins_is_not_below_a_floor():
    pinned = dict(line.split("==") for line in lines("constraints.txt"))
    for dependency in PROJECT["dependencies"]:
        name, floor = re.match(r"([A-Za-z0-9-]+)>=([0-9.]+)", dependency).groups()
        assert numbers(pinned[name]) >= numbers(floor), name


@pytest.mark.process
def test_a_word_that_the_wheels_test_does_not_know_is_named():
    done = subprocess.run(
        ["sh", "tools/wheel-test.sh", sys.executable, "--lower"], check=False, cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr == "wheel-test: --lower: expected --once, --lowest or --newest\n"
