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

ROOT: Final = Path(__file__).parents[2]
SKIN: Final = ROOT / "tests" / "runtime" / "skin_process.py"
TINY: Final = ROOT / "tests" / "golden" / "tiny.eitskin"
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
    honest: list["Honest"] = field(default_factory=list)

    def join(self, *keys: str) -> "Honest":
        """Start an honest subscriber and return once it has a frame."""
        self.honest.append(Honest(self.frames, *keys))
        return self.honest[-1]

    def said(self) -> str:
        """Return the runtime's standard error."""
        return self.stderr.read_text(errors="replace")


class Honest:
    """An honest subscriber in a process of its own; end it with ``leave``."""

    def __init__(self, endpoint: str, *keys: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.attack.honest", endpoint, *keys], stdout=subprocess.PIPE, text=True, cwd=ROOT
        )
        assert self._process.stdout is not None
        if self._process.stdout.readline().strip() != "subscribed":
            self.kill()
            raise RuntimeError(f"no frame came from {endpoint}")
        self._found: dict[str, Any] | None = None

    def leave(self) -> dict[str, Any]:
        """End it and return what it counted: frames, lost, longest_silence_s."""
        if self._found is None:
            self._process.terminate()
            out, _ = self._process.communicate(timeout=PATIENCE_S)
            self._found = json.loads(out.splitlines()[-1])
        return self._found

    def kill(self) -> None:
        """End it by force, if it runs."""
        self._process.kill()
        self._process.communicate()


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
    with tempfile.TemporaryDirectory(prefix="a") as name:
        folder = Path(name)
        stderr = folder / "stderr"
        limited = None if files is None else partial(resource.setrlimit, resource.RLIMIT_NOFILE, (files, files))
        where = list(endpoints) or ["--publish", f"ipc://{folder}/f", "--control", f"ipc://{folder}/c"]
        common = ("--bundle", str(TINY), "--reference-frames", "20")
        with _port(port, options) as used, stderr.open("w") as out:
            runtime = subprocess.Popen(
                [sys.executable, "-m", "eitskin_tools.cli", "run", *common, "--port", used, *where, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                preexec_fn=limited,  # noqa: PLW1509 -- one system call, and no thread runs
            )
            stream = None
            try:
                publish, control = _ready(runtime, out)
                stream = Stream(used, runtime, publish, control, folder, stderr)
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
