"""The versions that pyproject.toml allows, and those that CI runs the runtime's tests at."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import eitskin

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


def test_every_place_states_the_version_of_pyproject():
    version = PROJECT["version"]
    assert eitskin.__version__ == version
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert re.search(r"^## (\S+) - \d{4}-\d\d-\d\d$", (ROOT / "CHANGELOG.md").read_text(), re.M)[1] == version


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
    assert done.stderr == "wheel-test: --lower: expected --once, --short, --lowest or --newest\n"


NO_INDEX = """#!/bin/sh
case "$*" in
    -c*) echo 3.11 ;;
    "-m venv "*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
    *download*) echo "ERROR: No matching distribution found for numpy==0 (from versions: none)" >&2; exit 1 ;;
    *) exit 9 ;;
esac
"""
"""An interpreter whose pip reaches nobody."""


def program(path, text):
    path.write_text(text)
    path.chmod(0o755)
    return path


def said(words, ci, **more):
    """Return the exit status of a script and what it said, with CI set so."""
    environment = {name: value for name, value in os.environ.items() if name != "CI"} | ({"CI": ci} if ci else {})
    done = subprocess.run(
        list(map(str, words)), check=False, capture_output=True, text=True, **{"env": environment} | more
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.process
@pytest.mark.parametrize("versions", ["lowest", "newest"])
def test_without_an_index_ci_fails_and_others_skip(tmp_path, versions):
    (tmp_path / ".build" / "wheel").mkdir(parents=True)
    (tmp_path / ".build" / "wheel" / "x.whl").write_text("")
    for name in ("constraints.txt", "constraints-lowest.txt"):
        (tmp_path / name).write_text((ROOT / name).read_text())
    python = program(tmp_path / "python", NO_INDEX)
    words = [ROOT / "tools" / "wheel-test.sh", python, f"--{versions}"]
    status, text = said(words, "", cwd=tmp_path)
    assert (status, "skipped the" in text) == (0, True), text
    status, text = said(words, "true", cwd=tmp_path)
    assert status == 1
    assert f"the {versions} dependencies under Python 3.11 cannot be tested: no package index answers" in text


@pytest.mark.process
@pytest.mark.parametrize(
    ("candidate", "ci", "status", "found"),
    [
        ("3.13.5-1", "true", 1, "install it with 'apt-get install python3.13-venv'; with CI=true that is a failure"),
        ("3.13.5-1", "", 0, "skipped Python 3.13: no Python 3.13 with venv found"),
        ("(none)", "true", 0, "and apt has none"),
    ],
)
def test_without_an_interpreter_ci_fails_if_it_can_be_had(tmp_path, candidate, ci, status, found):
    program(tmp_path / "apt-cache", f"#!/bin/sh\necho '  Candidate: {candidate}'\n")
    environment = {"PATH": f"{tmp_path}:/usr/bin:/bin", "CI": ci}
    done = said([ROOT / "tools" / "no-python.sh", "3.13", "Python 3.13"], ci, env=environment)
    assert done[0] == status
    assert found in done[1]


def test_every_target_says_what_it_leaves_out():
    text = (ROOT / "Makefile").read_text()
    found = re.findall(r"^(wheel-test-\w+): wheel\n((?:\t.*\n)+)", text, re.MULTILINE)
    assert [name for name, _ in found] == ["wheel-test-others", "wheel-test-lowest", "wheel-test-newest"]
    assert all("tools/no-python.sh" in recipe and "skipped" not in recipe for _, recipe in found)
