"""The container is built from its recipe and runs; only what must come from outside, and cannot be had, skips it."""

import os
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from eitskin_tools.commands.service import text_of

SOURCE = Path(__file__).parents[3]

UNREACHABLE = (
    re.compile(
        r"Retry\(total=0,[^\n]* after connection broken by [^\n]*/([\w.-]+)/\n"
        r".*No matching distribution found for \1\b",
        re.DOTALL,
    ),
    re.compile(r"Max retries exceeded with url"),
)
"""Pip's own words once it has given up an index, and a file of one; what merely had to be asked for again goes on."""


def container_tool():
    """Return a container tool that works, or skip with what is missing."""
    missing = []
    for name in ("podman", "docker", "buildah"):
        if (program := shutil.which(name)) is None:
            missing.append(f"{name} is not installed")
            continue
        asked = ran(program, "info", timeout_s=120)
        if asked.returncode == 0 and name != "buildah":
            return program
        missing.append(f"{name}: {last_line(asked, 'cannot run what it builds')}")
    pytest.skip("; ".join(missing))


def ran(*words, timeout_s=1800):
    return subprocess.run(words, capture_output=True, text=True, check=False, timeout=timeout_s)


def last_line(found, otherwise):
    return (found.stderr.strip().splitlines() or [otherwise])[-1]


def bases(recipe):
    """Return the images that a recipe builds on; its own stages are none."""
    found = re.findall(r"^FROM (\S+)(?: AS (\S+))?$", recipe, re.MULTILINE)
    stages = {stage for _, stage in found}
    return list(dict.fromkeys(image for image, _ in found if image not in stages))


def build(program, recipe, tag):
    """Build an image of the source; skip where the base image or pip's index cannot be had, and fail for all else."""
    for image in bases(recipe.read_text()):
        if ran(program, "image", "inspect", image).returncode == 0:
            continue
        pulled = ran(program, "pull", image)
        if pulled.returncode:
            pytest.skip(f"{image} cannot be had: {last_line(pulled, f'status {pulled.returncode}')}")
    form = ["--format", "docker"] if "podman" in program else []
    built = ran(program, "build", *form, "-t", tag, "-f", str(recipe), str(SOURCE))
    said = built.stdout + built.stderr
    if built.returncode and any(words.search(said) for words in UNREACHABLE):
        pytest.skip(f"pip reaches no index while the image is built: {last_line(built, 'it has given up')}")
    assert built.returncode == 0, said


@pytest.mark.process
@pytest.mark.slow
def test_the_container_is_built_and_runs(tmp_path):
    program = container_tool()
    recipe = tmp_path / "Containerfile"
    recipe.write_text(text_of("Containerfile", "robot", "/usr/bin/eitskin"))
    build(program, recipe, "eitskin-test")
    for words, wanted in ((["--version"], "eitskin "), (["run", "--config", "/none.toml"], "no file '/none.toml'")):
        found = ran(program, "run", "--rm", "eitskin-test", *words, timeout_s=300)
        assert wanted in found.stdout + found.stderr
    who = ran(program, "run", "--rm", "--entrypoint", "id", "eitskin-test", "-u", timeout_s=300)
    assert who.stdout.strip() == "10001"


IMAGE = "docker.io/library/python:3.12-slim-bookworm"

ORDINARY = """\
#1 [internal] load metadata for docker.io/library/python:3.12-slim-bookworm from the registry
#4 [build 1/3] FROM docker.io/library/python:3.12-slim-bookworm
#4 resolve docker.io/library/python:3.12-slim-bookworm done
Resolved "python" as an alias; Trying to pull docker.io/library/python; dial tcp: retried; Copying blob done
"""
"""What builders say of any build; each word of it once passed for an image that cannot be had."""

AGAIN = """\
#6 2.1 WARNING: Retrying (Retry(total=4, connect=None, read=None, redirect=None, status=None)) after connection broken \
by 'ReadTimeoutError("HTTPSConnectionPool(host='index.example', port=443): Read timed out.")': /simple/numpy/
"""

NO_SUCH = "#6 9.9 ERROR: No matching distribution found for numpy==0.0.1\n"

FAKE = """#!/bin/sh
echo "$1 $2" >> "{folder}/asked"
case "$1" in
    info) exit 0 ;;
    image) exit {here} ;;
    pull) echo "Trying to pull $2..." >&2; echo "Error: dial tcp: lookup the registry: no such host" >&2; exit {pull} ;;
    build) cat "{folder}/said" >&2; exit {build} ;;
esac
exit 64
"""


@pytest.fixture
def tool(tmp_path, monkeypatch):
    """Return what has a container tool that answers as told build, and says how it ended; and what it was asked."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    recipe = tmp_path / "Containerfile"
    recipe.write_text(text_of("Containerfile", "robot", "/usr/bin/eitskin"))
    asked = folder / "asked"

    def built(*, here=1, pull=0, status=0, said=ORDINARY):
        (folder / "said").write_text(said)
        fake = folder / "podman"
        fake.write_text(FAKE.format(folder=folder, here=here, pull=pull, build=status))
        fake.chmod(0o755)
        try:
            build(container_tool(), recipe, "eitskin-test")
        except pytest.skip.Exception as skipped:  # which would skip the test of it
            return "skipped", str(skipped)
        except AssertionError as failed:
            return "failed", str(failed)
        return "built", ""

    return built, lambda: [line.split()[0] for line in asked.read_text().splitlines()]


@pytest.mark.process
def test_a_base_image_that_cannot_be_had_skips_with_the_reason_and_nothing_is_built(tool):
    built, asked = tool
    reason = f"{IMAGE} cannot be had: Error: dial tcp: lookup the registry: no such host"
    assert built(pull=125) == ("skipped", reason)
    assert asked() == ["info", "image", "pull"]


@pytest.mark.process
def test_a_base_image_that_is_here_is_not_asked_for(tool):
    built, asked = tool
    assert built(here=0, pull=125) == ("built", "")
    assert asked() == ["info", "image", "build"]


@pytest.mark.process
@pytest.mark.parametrize(
    "said", ["", ORDINARY, ORDINARY + AGAIN, ORDINARY + NO_SUCH, ORDINARY + AGAIN + NO_SUCH],
    ids=["silent", "ordinary", "asked again", "no such version", "asked again, no such version"],
)  # fmt: skip
def test_a_build_that_fails_is_a_failure_whatever_builders_say_of_any_build(tool, said):
    built, asked = tool
    how, text = built(status=1, said=said)
    assert how == "failed"
    assert [line for line in said.splitlines() if line not in text] == []
    assert asked() == ["info", "image", "pull", "build"]


@pytest.mark.process
@pytest.mark.parametrize("said", [ORDINARY, ORDINARY + AGAIN], ids=["ordinary", "asked again"])
def test_a_build_that_succeeds_is_built(tool, said):
    built, asked = tool
    assert built(said=said) == ("built", "")
    assert asked() == ["info", "image", "pull", "build"]


@pytest.mark.process
def test_a_build_whose_pip_reaches_no_index_skips_by_the_words_of_pip_itself(tool, tmp_path, monkeypatch):
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.setenv(name, "127.0.0.1")
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))
        index = f"http://127.0.0.1:{deaf.getsockname()[1]}/simple"
        words = ["install", "--isolated", "--no-input", "--retries", "1", "--index-url", index]
        pip = ran(sys.executable, "-m", "pip", *words, "--target", str(tmp_path / "none"), "hatchling")
    if "No module named pip" in pip.stderr:
        pytest.skip("no pip here whose words could be taken")
    assert pip.returncode == 1
    lines = (pip.stdout + pip.stderr).splitlines()
    built, _ = tool
    how, text = built(status=1, said=ORDINARY + "".join(f"#6 1.0 {line}\n" for line in lines))
    assert (how, text.split(":")[0]) == ("skipped", "pip reaches no index while the image is built")
    other = [line.replace("found for hatchling", "found for hatch") for line in lines]
    assert built(status=1, said="\n".join(other))[0] == "failed", "it had the index of what it did not find"


@pytest.mark.process
def test_a_build_whose_pip_loses_the_index_amid_a_file_skips(tool):
    built, _ = tool
    lost = "HTTPSConnectionPool(host='pythonhosted.org', port=443): Max retries exceeded with url: /packages/x.whl"
    how, text = built(status=1, said=f"#6 9.9 ERROR: Could not install packages due to an OSError: {lost}\n")
    assert how == "skipped"
    assert lost in text


def test_the_images_that_a_recipe_builds_on_are_those_behind_from():
    assert bases(text_of("Containerfile", "robot", "/usr/bin/eitskin")) == [IMAGE]
    assert bases("FROM a AS one\nFROM one\nFROM b:2 AS two\nFROM a\n") == ["a", "b:2"]
