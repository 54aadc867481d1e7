"""The container is built from its recipe and runs; only what must come from outside, and cannot be had, skips it."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from eitskin_tools.commands.service import text_of

SOURCE = Path(__file__).parents[3]

UNREACHABLE = re.compile(r"No matching distribution found for|Max retries exceeded with url")
"""Pip's own words once it has given up an index."""


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
    if built.returncode and UNREACHABLE.search(said):
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
