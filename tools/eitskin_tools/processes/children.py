"""Child processes: starts, watches and ends them, restarts them after growing pauses, and keeps their last output.

Each child has a process group of its own, so that Ctrl-C reaches the parent alone, which then ends its children in
order. The kernel ends them if the parent dies first.

:class:`ChildProcess` is what the demonstration, ``eitskin run --config`` and the verifier have in common;
:class:`Child` adds files for its output.
"""

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eitskin_proto.errors import SkinError
from eitskin_tools.processes.signals import endings, met_by

GRACE_S: Final = 20.0
"""How long a child may take to end after it was asked to; far more than it needs, since a busy machine is no hang."""

PR_SET_PDEATHSIG: Final = 1
"""Option of prctl(2): the signal that a process gets when its parent dies."""

_LIBC: Final = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None


@dataclass(frozen=True, slots=True)
class Backoff:
    """Pauses before a child that failed is started again.

    Attributes:
        first_s: Before the first new start; each further pause is twice as long.
        longest_s: Longest pause.
        settled_s: A child that ran for so long begins with the first pause again.
    """

    first_s: float = 1.0
    longest_s: float = 30.0
    settled_s: float = 60.0

    def pause_s(self, failures: int) -> float:
        """Return the pause after this many failures in a row, from 1 on."""
        return float(min(self.first_s * 2.0 ** min(failures - 1, 60), self.longest_s))


class ChildProcess:
    """One child, now and after each new start.

    Args:
        command: Program and arguments.
        backoff: Pauses between starts.
    """

    def __init__(self, command: Sequence[str], backoff: Backoff | None = None) -> None:
        self.command, self.backoff = list(command), backoff or Backoff()
        self.restarts = 0
        self.failures = 0
        """In a row."""
        self.process: subprocess.Popen[bytes] | None = None

    def start(self, **options: Any) -> subprocess.Popen[bytes]:
        """Start it, without an input of its own.

        Args:
            options: As for :class:`subprocess.Popen`.

        Raises:
            OSError: There are too few processes, descriptors or memory.
        """
        self.process = subprocess.Popen(self.command, stdin=subprocess.DEVNULL, process_group=0, **options)
        return self.process

    @property
    def pid(self) -> int:
        """Its process id; 0 while none runs."""
        process = self.process
        return 0 if process is None else process.pid

    @property
    def status(self) -> int | None:
        """Exit status, or None while it runs."""
        return None if self.process is None else self.process.poll()

    def wait(self, timeout_s: float) -> int | None:
        """Wait for its end; return its status, or None if it runs on."""
        try:
            return None if self.process is None else self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return None

    def stop(self, number: signal.Signals = signal.SIGINT, grace_s: float = GRACE_S) -> None:
        """End it: by a signal, and after the grace by force."""
        if self.process is not None:
            if self.process.poll() is None:
                self.process.send_signal(number)
                if self.wait(grace_s) is None:
                    self.process.kill()
            self.process.wait()

    def next_pause_s(self) -> float:
        """Count a failure, and return the pause before the next start."""
        self.failures += 1
        return self.backoff.pause_s(self.failures)


def how_it_ended(status: int, last_words: str) -> str:
    """Return in words how a process ended, and the last that it said."""
    how = f"by signal {-status} ({signal.strsignal(-status)})" if status < 0 else f"with status {status}"
    return f"ended {how}" + (f": {last_words}" if last_words else "")


def last_line(text: str) -> str:
    """Return the last line of a text that is not blank; empty if there is none."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else ""


class ChildDiedError(SkinError):
    """A child process ended before its time."""


class Child(ChildProcess):
    """A Python module as a child, started at once, whose output goes to files.

    Args:
        name: Its name in messages.
        module: Python module that it runs.
        arguments: Of its command line.
        folder: Where its output goes, ``NAME.out`` and ``NAME.err``.
        environment: Additional environment variables.
    """

    def __init__(
        self,
        name: str,
        module: str,
        arguments: Sequence[str],
        folder: Path,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__([sys.executable, "-m", module, *arguments])
        self.name = name
        self.out, self.err = folder / f"{name}.out", folder / f"{name}.err"
        variables = None if environment is None else {**os.environ, **environment}
        with self.out.open("wb") as out, self.err.open("wb") as err:
            # no thread runs yet, and the function is one system call
            self.start(stdout=out, stderr=err, env=variables, preexec_fn=die_with_parent)

    def check(self) -> None:
        """Raise ChildDiedError if it has ended."""
        if self.status is not None:
            raise ChildDiedError(f"{self.name} ended with status {self.status}: {self.last_words()}")

    def last_words(self) -> str:
        """Return the last line of its standard error."""
        return last_line(self.err.read_text(errors="replace")) or "it printed nothing"

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


@contextmanager
def process_group() -> Iterator[list[Child]]:
    """Give a list for children; those in it when the block ends are ended, the last one first."""
    children: list[Child] = []
    try:
        yield children
    finally:
        with met_by(signal.SIG_IGN, *endings()):  # no second Ctrl-C
            for child in reversed(children):
                child.stop()


def die_with_parent(number: signal.Signals = signal.SIGTERM) -> None:
    """Have the kernel send this process a signal when its parent ends; call it in the forked child."""
    if _LIBC is not None:
        _LIBC.prctl(PR_SET_PDEATHSIG, number)
