"""A stream to attack: a virtual skin, ``eitskin run`` and an honest subscriber, each a process of its own."""

import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[2]
SKIN: Final = ROOT / "tests" / "runtime" / "skin_process.py"
TINY: Final = ROOT / "tests" / "golden" / "tiny.eitskin"
PATIENCE_S: Final = 600.0
"""How long anything may take that is not itself what is measured: who waits so long waits in vain."""


@dataclass
class Stream:
    """What runs."""

    runtime: subprocess.Popen[str]
    frames: str
    """Where it publishes."""
    control: str
    stderr: Path
    """What the runtime says."""
    honest: list["Honest"] = field(default_factory=list)

    def join(self, *keys: str, number: int = 1) -> "Honest":
        """Start honest subscribers and return once each has a frame."""
        self.honest.append(Honest(self.frames, *keys, number=number))
        return self.honest[-1]

    def said(self) -> str:
        """Return the runtime's standard error."""
        return self.stderr.read_text(errors="replace")


class Honest:
    """Honest subscribers in a process of their own; end it with ``leave``."""

    def __init__(self, endpoint: str, *keys: str, number: int = 1) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.attack.crowd", endpoint, str(number), *keys],
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        assert self._process.stdout is not None
        if self._process.stdout.readline().strip() != "subscribed":
            self.kill()
            raise RuntimeError(f"no frame came from {endpoint} to each of {number}")
        self._found: dict[str, Any] | None = None

    def leave(self) -> dict[str, Any]:
        """End it and return what it counted: frames, lost, behind, longest_silence_s."""
        if self._found is None:
            self._process.terminate()
            out, _ = self._process.communicate(timeout=PATIENCE_S)
            self._found = json.loads(out.splitlines()[-1])
        return self._found

    def kill(self) -> None:
        """End it by force, if it runs."""
        self._process.kill()
        self._process.communicate()


def start_skin(**options: Any) -> tuple[subprocess.Popen[str], str]:
    """Start the tests' virtual skin, whose line loses nothing; return its process and its port."""
    process = subprocess.Popen([sys.executable, str(SKIN), json.dumps(options)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, process.stdout.readline().split()[0]


@contextmanager
def virtual_skin(**options: Any) -> Iterator[str]:
    """Run the tests' virtual skin and give its port."""
    process, port = start_skin(**options)
    try:
        yield port
    finally:
        ended(process)


@contextmanager
def attacked(
    *arguments: str, files: int | None = None, endpoints: Sequence[str] = (), port: str | None = None, **options: Any
) -> Iterator[Stream]:
    """Run a skin and ``eitskin run`` on it, and give the stream once it is ready.

    Args:
        arguments: Further options of ``eitskin run``.
        files: Hard limit of open files of the runtime.
        endpoints: ``--publish`` and what else names endpoints; without it, ipc in a folder of its own.
        port: A device's port; None starts the tests' virtual skin.
        options: Of the virtual skin.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="a")))
        if port is None:
            port = stack.enter_context(virtual_skin(**options))
        out = stack.enter_context((folder / "stderr").open("w"))
        limited = None if files is None else partial(resource.setrlimit, resource.RLIMIT_NOFILE, (files, files))
        where = list(endpoints) or ["--publish", f"ipc://{folder}/f", "--control", f"ipc://{folder}/c"]
        common = ("--bundle", str(TINY), "--reference-frames", "20")
        runtime = subprocess.Popen(
            [sys.executable, "-m", "eitskin_tools.cli", "run", *common, "--port", port, *where, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            preexec_fn=limited,  # noqa: PLW1509 -- one system call, and no thread runs
        )
        stack.callback(ended, runtime)
        stream = Stream(runtime, *_ready(runtime, out), folder / "stderr")
        stack.callback(lambda: [one.kill() for one in stream.honest])
        yield stream


def _ready(runtime: subprocess.Popen[str], out: Any) -> tuple[str, str]:
    """Copy what it says until it is ready; from then on its standard error goes on to be copied by a thread."""
    assert runtime.stderr is not None
    for line in runtime.stderr:
        out.write(line)
        out.flush()
        words = line.split()
        if "ready" in words and "control" in words:
            at = words.index("ready")
            threading.Thread(target=_copy, args=(runtime.stderr, out), daemon=True).start()
            return words[at + 3], words[at + 5]
    said = Path(out.name).read_text(errors="replace").strip()
    raise RuntimeError(f"the runtime ended with {runtime.wait(PATIENCE_S)} before it was ready: {said[-400:]}")


def _copy(source: Any, out: Any) -> None:
    with suppress(ValueError):  # closed
        for line in source:
            out.write(line)
            out.flush()


def ended(process: "subprocess.Popen[str]") -> None:
    """End a process of the attack itself, by force if need be."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    for pipe in (process.stdout, process.stderr):
        if pipe is not None and not pipe.closed:
            with suppress(OSError):
                os.set_blocking(pipe.fileno(), False)
            pipe.close()
