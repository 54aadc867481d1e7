"""A stream to attack: a virtual skin, ``eitskin run`` and an honest subscriber, each a process of its own."""

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from .pace import Passed, pace

ROOT: Final = Path(__file__).parents[2]
SKIN: Final = ROOT / "tests" / "runtime" / "skin_process.py"
TINY: Final = ROOT / "tests" / "golden" / "tiny.eitskin"
EITSKIN: Final = ("-m", "eitskin_tools.cli")
PATIENCE_S: Final = 600.0
"""How long anything may take that is not itself what is measured: who waits so long waits in vain."""


@dataclass
class Stream:
    """What runs."""

    port: str
    runtime: subprocess.Popen[str]
    frames: str
    """Where it publishes."""
    control: str
    folder: Path
    stderr: Path
    """What the runtime says."""
    wire: Path | None = None
    """Where the virtual skin notes when each frame went onto the line, if it is ours."""
    honest: list["Honest"] = field(default_factory=list)

    def join(self, *keys: str) -> "Honest":
        """Start an honest subscriber and return once it has a frame."""
        self.honest.append(Honest(self, *keys))
        return self.honest[-1]

    def paced(self, found: dict[str, Any]) -> dict[str, Any]:
        """Return what a subscriber counted with the stream's pace in place of what that follows from."""
        passed, waited_ns = found.pop("passed"), found.pop("waited_ns")
        return found | {"pace": None if self.wire is None else paced(self.wire, passed, waited_ns)}

    def said(self) -> str:
        """Return the runtime's standard error."""
        return self.stderr.read_text(errors="replace")


class Honest:
    """An honest subscriber in a process of its own; end it with ``leave``."""

    def __init__(self, stream: Stream, *keys: str) -> None:
        endpoint, self._stream = stream.frames, stream
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.attack.honest", endpoint, str(stream.runtime.pid), *keys],
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        assert self._process.stdout is not None
        if self._process.stdout.readline().strip() != "subscribed":
            self.kill()
            raise RuntimeError(f"no frame came from {endpoint}")
        self._found: dict[str, Any] | None = None

    def leave(self) -> dict[str, Any]:
        """End it and return what it counted: frames, lost, longest_silence_s, pace (:mod:`tests.attack.pace`)."""
        if self._found is None:
            self._process.terminate()
            out, _ = self._process.communicate(timeout=PATIENCE_S)
            self._found = self._stream.paced(json.loads(out.splitlines()[-1]))
        return self._found

    def kill(self) -> None:
        """End it by force, if it runs."""
        self._process.kill()
        self._process.communicate()


def paced(wire: Path, passed: Sequence[Sequence[int]], waited_ns: int) -> float | None:
    """Return the pace of a stream of the virtual skin.

    Args:
        wire: Where it noted when each frame went onto the line.
        passed: Of every frame its number, sequence number, device clock in us, and when it was published in ns.
        waited_ns: How long the runtime was without a core.
    """
    sent_ns = np.load(wire, mmap_mode="r")
    frames = [
        Passed(number, sequence, 1000 * device_us, int(sent_ns[sequence % len(sent_ns)]), published_ns)
        for number, sequence, device_us, published_ns in passed
    ]
    found = pace(frames, waited_ns)
    return None if found is None else round(found, 3)


@contextmanager
def virtual_skin(**options: Any) -> Iterator[str]:
    """Run the tests' virtual skin with these options and give its port; its line loses nothing."""
    process = subprocess.Popen([sys.executable, str(SKIN), json.dumps(options)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process.stdout.readline().strip()
    finally:
        ended(process)


@contextmanager
def attacked(
    *arguments: str,
    files: int | None = None,
    endpoints: Sequence[str] = (),
    port: str | None = None,
    program: Sequence[str] = EITSKIN,
    **options: Any,
) -> Iterator[Stream]:
    """Run a skin and ``eitskin run`` on it, and give the stream once it is ready.

    Args:
        arguments: Further options of ``eitskin run``.
        files: Hard limit of open files of the runtime.
        endpoints: ``--publish`` and what else names endpoints; without it, ipc in a folder of its own.
        port: A device's port; None starts the tests' virtual skin.
        program: What Python runs as ``eitskin``.
        options: Of the virtual skin.
    """
    with tempfile.TemporaryDirectory(prefix="a") as name:
        folder = Path(name)
        stderr = folder / "stderr"
        limited = None if files is None else partial(resource.setrlimit, resource.RLIMIT_NOFILE, (files, files))
        where = list(endpoints) or ["--publish", f"ipc://{folder}/f", "--control", f"ipc://{folder}/c"]
        common = ("--bundle", str(TINY), "--reference-frames", "20")
        wire = folder / "wire.npy" if port is None else None
        told = options if wire is None else options | {"wire": str(wire)}
        with _port(port, told) as used, stderr.open("w") as out:
            runtime = subprocess.Popen(
                [sys.executable, *program, "run", *common, "--port", used, *where, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                cwd=ROOT,
                preexec_fn=limited,  # noqa: PLW1509 -- one system call, and no thread runs
            )
            stream = None
            try:
                publish, control = _ready(runtime, out)
                stream = Stream(used, runtime, publish, control, folder, stderr, wire)
                yield stream
            finally:
                for honest in stream.honest if stream else ():
                    honest.kill()
                ended(runtime)


@contextmanager
def _port(port: str | None, options: dict[str, Any]) -> Iterator[str]:
    if port is not None:
        yield port
        return
    with virtual_skin(**options) as found:
        yield found


def _ready(runtime: subprocess.Popen[str], out: Any) -> tuple[str, str]:
    """Copy what it says until it is ready; from then on its standard error goes on to be copied by a thread."""
    import threading

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
            process.send_signal(signal.SIGKILL)
            process.wait()
    for pipe in (process.stdout, process.stderr):
        if pipe is not None:
            with suppress(OSError):
                os.set_blocking(pipe.fileno(), False)
            pipe.close()
