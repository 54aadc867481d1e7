"""A virtual skin and a runtime as processes, as a user has them; every wait is for what they say."""

import os
import subprocess
import sys
import threading
from contextlib import contextmanager
from dataclasses import dataclass

import pytest

from .markdown import ROOT

PATIENCE_S = 120.0
"""A process that says nothing for so long is stuck, however busy the machine is."""


class Process:
    """A process whose lines are read one by one; both its outputs are one stream."""

    def __init__(self, *words, folder, python=sys.executable, **environment):
        self.said = []
        self._listener = None
        self._process = subprocess.Popen(
            [python, *map(str, words)],
            cwd=folder,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def until(self, wanted):
        """Return the next line that holds a text, or fail with what was said instead."""
        watchdog = threading.Timer(PATIENCE_S, self._process.kill)
        watchdog.start()
        try:
            for line in self._process.stdout:
                self.said.append(line.rstrip())
                if wanted in line:
                    return self.said[-1]
        finally:
            watchdog.cancel()
        raise AssertionError(f"{wanted!r} was not said, but: {self.said}")

    def listen(self):
        """Read all that it says from now on into ``said``, in a thread."""
        self._listener = threading.Thread(target=lambda: self.said.extend(map(str.rstrip, self._process.stdout)))
        self._listener.start()

    def ends(self):
        """Wait for its end; return the line that it said last."""
        out, _ = self._process.communicate(timeout=PATIENCE_S)
        self.said += out.splitlines()
        assert self._process.returncode == 0, self.said
        return self.said[-1] if self.said else ""

    def end(self):
        self._process.terminate()
        if self._listener is not None:
            self._listener.join(PATIENCE_S)
        self._process.communicate()


@dataclass(frozen=True)
class Runtime:
    """Where a runtime is."""

    frames: str
    control: str


@pytest.fixture(scope="session")
def start(tmp_path_factory):
    """Return a context manager that runs Python with these words, and ends it."""
    folder = tmp_path_factory.mktemp("examples")

    @contextmanager
    def started(*words, **environment):
        process = Process(*words, folder=folder, **environment)
        try:
            yield process
        finally:
            process.end()

    return started


@pytest.fixture(scope="session")
def example(start):
    """Return a context manager that runs one of docs/examples."""

    def run(name, *words, **environment):
        return start(ROOT / "docs/examples" / name, *words, **environment)

    return run


@pytest.fixture(scope="session")
def skin(start):
    """Return a context manager that runs a virtual skin and gives its port."""

    @contextmanager
    def running():
        with start("-m", "eitskin_tools.cli", "virtual-skin", "--rate", "50") as process:
            said = process.until("ttySKIN")
            yield next(word for word in said.split() if "ttySKIN" in word)

    return running


@pytest.fixture(scope="session")
def runtime(start, skin, tmp_path_factory):
    """A virtual skin and a runtime that publishes it."""
    folder = tmp_path_factory.mktemp("runtime")
    where = Runtime(f"ipc://{folder}/frames", f"ipc://{folder}/control")
    words = ["--reference-frames", "20", "--publish", where.frames, "--control", where.control]
    with skin() as port, start("-m", "eitskin_tools.cli", "run", "--port", port, *words) as process:
        process.until("ready publishing")
        yield where
