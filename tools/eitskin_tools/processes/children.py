"""The processes of the demonstration: started together, watched together, and gone together.

Each child has a process group of its own, so that Ctrl-C reaches the parent alone, which then ends them in order. The
kernel ends them if the parent dies without having the chance. Their standard error goes to files; the last line of it
is what the demonstration reports when one of them dies.
"""

import ctypes
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from eitskin_proto.errors import SkinError
from eitskin_tools.processes.signals import endings, met_by

GRACE_S: Final = 20.0
"""How long a child may take to end after it was asked to; far more than it needs, since a busy machine is no hang."""

PR_SET_PDEATHSIG: Final = 1
"""Option of prctl(2): the signal that a process gets when its parent dies."""

_LIBC: Final = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None


class ChildDiedError(SkinError):
    """A process of the demonstration ended before its time."""


class Child:
    """One process.

    Args:
        name: What messages call it.
        module: Python module that it runs.
        arguments: Of its command line.
        folder: Where its output goes, ``NAME.out`` and ``NAME.err``.
    """

    def __init__(self, name: str, module: str, arguments: Sequence[str], folder: Path) -> None:
        self.name = name
        self.out, self.err = folder / f"{name}.out", folder / f"{name}.err"
        with self.out.open("wb") as out, self.err.open("wb") as err:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                process_group=0,
                preexec_fn=die_with_parent,  # noqa: PLW1509 -- no thread runs yet, and the function is one system call
            )

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def status(self) -> int | None:
        """Exit status, or None while it runs."""
        return self._process.poll()

    def check(self) -> None:
        """Raise ChildDiedError if it has ended."""
        if self.status is not None:
            raise ChildDiedError(f"{self.name} ended with status {self.status}: {self.last_words()}")

    def last_words(self) -> str:
        """Return the last line of its standard error, without the command's name."""
        lines = [line.strip() for line in self.err.read_text(errors="replace").splitlines() if line.strip()]
        return lines[-1] if lines else "it said nothing"

    def line(self, path: Path, start: str, timeout_s: float, others: Sequence["Child"] = ()) -> str:
        """Wait for a line of one of its outputs and return it.

        Args:
            path: ``self.out`` or ``self.err``.
            start: How the line starts.
            timeout_s: How long to wait.
            others: Children that must live meanwhile.

        Raises:
            ChildDiedError: It, or another one, ended first.
            TimeoutError: The line did not come.
        """
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            text = path.read_text(errors="replace")
            for line in text[: text.rfind("\n") + 1].splitlines():
                if line.startswith(start):
                    return line
            for child in (self, *others):
                child.check()
            time.sleep(0.02)
        raise TimeoutError(f"{self.name} was not ready within {timeout_s:g} s: {self.last_words()}")

    def wait(self, timeout_s: float) -> int | None:
        """Wait for its end; return its status, or None if it runs on."""
        try:
            return self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return None

    def stop(self) -> None:
        """End it: by SIGINT, then by force."""
        if self.status is None:
            self._process.send_signal(signal.SIGINT)
            if self.wait(GRACE_S) is None:
                self._process.kill()
        self._process.wait()


@contextmanager
def process_group() -> Iterator[list[Child]]:
    """Give a list for children; whoever is in it when the block ends is ended, the last one first."""
    children: list[Child] = []
    try:
        yield children
    finally:
        with met_by(signal.SIG_IGN, *endings()):  # no second Ctrl-C
            for child in reversed(children):
                child.stop()


def die_with_parent() -> None:
    """Have the kernel end this process when its parent ends: to be called in a child that was just forked."""
    if _LIBC is not None:
        _LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
