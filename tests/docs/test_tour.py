"""The five commands of the quickstart, typed as they stand there, in an environment as ``make demo`` leaves it.

``pytest tests/docs/test_tour.py -m slow -s`` prints how long each took until it was done, or until what it is for was
there: the port, the first published frame, the picture in the browser.
"""

import os
import re
import shlex
import subprocess
import sys
import time

import pytest

from ..tools.view.chromium import PROGRAM, Browser
from .conftest import Process
from .markdown import ROOT

_, _, AFTER = (ROOT / "docs/quickstart.md").read_text(encoding="utf-8").partition("## Record it, and see it again\n")
COMMANDS = [line.split("#")[0].strip() for line in re.search(r"\n((?:    .*\n)+)", AFTER)[1].splitlines()]
PATIENCE_S = 1200.0
"""How long pip may take on a busy machine."""


def test_the_tour_has_five_commands():
    words = [command.split()[:2] for command in COMMANDS]
    assert words == [["eitskin", name] for name in ("virtual-skin", "run", "record", "replay", "view")]


def pip(python, *words):
    """Run pip in the source's folder; skip where no package index is there."""
    done = subprocess.run(
        [python, "-m", "pip", "--disable-pip-version-check", "--quiet", "install", "--constraint", "constraints.txt",
         *words], cwd=ROOT, capture_output=True, text=True, check=False, timeout=PATIENCE_S,
    )  # fmt: skip
    if re.search(r"No matching distribution|Connection|Temporary failure|Max retries", done.stderr):
        pytest.skip(f"no package index: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr


class Tour:
    """A user who types one command after the other, each in a terminal of its own."""

    def __init__(self, folder, python):
        self._folder, self._python, self.took = folder, python, []
        self._left = []

    def types(self, command, until=None):
        """Run a command until it says something, or ends; return its line."""
        words = shlex.split(command)
        begin = time.monotonic()
        environment = {"XDG_RUNTIME_DIR": str(self._folder)}
        process = Process(
            "-m", "eitskin_tools.cli", *words[1:], folder=self._folder, python=self._python, **environment
        )
        self._left.append(process)
        said = process.until(until) if until else process.ends()
        self.took.append((time.monotonic() - begin, command))
        return said

    def ends_all(self):
        """Press Ctrl-C in every terminal."""
        while self._left:
            self._left.pop().end()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.ends_all()


@pytest.mark.process
@pytest.mark.slow
def test_the_tour_goes_as_it_stands_in_the_quickstart(tmp_path):
    environment = tmp_path / "v"
    subprocess.run([sys.executable, "-m", "venv", environment], check=True, timeout=PATIENCE_S)
    python = environment / "bin" / "python"
    demo = re.search(r"\$\(VENV\)/\.demo:.*\n.*--editable '(.*)'", (ROOT / "Makefile").read_text(encoding="utf-8"))
    begin = time.monotonic()
    pip(python, demo[1])  # as 'make demo' does
    installed_s = time.monotonic() - begin
    skin, run, record, replay, view = COMMANDS
    with Tour(tmp_path, python) as tour:
        port = next(word for word in tour.types(skin, "ttySKIN").split() if "ttySKIN" in word)
        tour.types(run.replace("PORT", port), "ready")
        tour.took[-1] = tour.took[-1][0], run
        tour.types(record)
        assert (tmp_path / "day.mcap").stat().st_size > 10_000
        tour.ends_all()
        tour.types(replay, "ready")
        said = tour.types(f"{view} --port 0 --no-open", "viewing ")
        address = next(word for word in said.split() if word.startswith("http://"))
        if PROGRAM is not None:
            with Browser() as page:
                page.open(address)
                page.wait("window.eitskin && eitskin.history?.shown")
                seconds, _ = tour.took.pop()
                tour.took.append((seconds + page.evaluate("performance.now() / 1000"), view))
                assert page.thrown == []
    print(f"{installed_s:6.1f} s  packages, once")
    for seconds, command in tour.took:
        print(f"{seconds:6.1f} s  {command}")
    print(f"{sum(seconds for seconds, _ in tour.took):6.1f} s  in all, {os.cpu_count()} cores")
