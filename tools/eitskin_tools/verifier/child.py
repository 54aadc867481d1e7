"""The runtime's side of the verifier's process: starts it, restarts it after growing pauses, gives it up, ends it."""

import json
import os
import signal
import socket
import sys
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Final

from eitskin.messaging.streams.verified import FAILED, STARTING, WAITING
from eitskin_tools.processes.children import Backoff, ChildProcess, how_it_ended, last_line
from eitskin_tools.processes.periodic_thread import PeriodicThread
from eitskin_tools.verifier.letters import LARGEST_PACKET

POLL_S: Final = 0.1
"""Between two looks."""

EXIT_TIMEOUT_S: Final = 0.2
"""How long leaving waits for its end. It needs a core to end as well, which it may not get for seconds at the lowest
priority; a killed verifier keeps nothing, and the kernel sees to the rest."""

MAX_FAILURES: Final = 5
"""In a row, after which it is given up."""

LAST_WORDS_BYTES: Final = 4096
"""Of its standard error that are read."""


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the verifier runs, and how."""

    nice: int = 10
    cpus: tuple[int, ...] = ()
    """None of them: those of this process."""
    idle: bool = False
    """Only while nothing else wants the core."""
    program: tuple[str, ...] = (sys.executable, "-m", "eitskin_tools.verifier.process")
    """What runs; a test gives its own."""


class VerifierProcess(PeriodicThread):
    """Runs a verifier from when it is entered to when it is left.

    Args:
        place: Where it runs.
        backoff: Pauses between starts.
        max_failures: In a row, after which it is given up.
    """

    def __init__(self, place: Placement, backoff: Backoff | None = None, max_failures: int = MAX_FAILURES) -> None:
        super().__init__("verifier-process", POLL_S)
        self.place = place
        self._child = ChildProcess(place.program, backoff)
        self._max_failures = max_failures
        self.line: socket.socket | None = None
        """The connection to the present process, for sending frames; a new object for each process."""
        self.state, self.why = STARTING, ""
        """``starting`` while a process is there, else ``waiting`` or ``failed``, and why."""
        self.ended = ""
        """How the previous process ended, for callers that look only after the next one has started."""
        self._errors = -1
        self._started_s = self._due_s = 0.0

    @property
    def pid(self) -> int:
        """Of the process; 0 while none runs."""
        return self._child.pid

    @property
    def restarts(self) -> int:
        """New starts since the first."""
        return self._child.restarts

    def check(self) -> None:
        """See whether it lives, and start it when it is time."""
        process = self._child.process
        if process is None:
            if self.state == WAITING and time.monotonic() >= self._due_s:
                self._child.restarts += 1
                self._start()
            return
        if process.poll() is not None:
            self._ended(process.returncode)
            return
        if time.monotonic() - self._started_s >= self._child.backoff.settled_s:
            self._child.failures = 0

    def _start(self) -> None:
        self._started_s = time.monotonic()
        try:
            self.line = self._started()
        except OSError as error:  # too few processes or descriptors: another time
            self._fail(f"cannot be started: {error.strerror or error}")
        else:
            self.state, self.why = STARTING, ""

    def _started(self) -> socket.socket:
        """Start the process, and return the line to it.

        Raises:
            OSError: It cannot be started.
        """
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with ExitStack() as failed, theirs:
            failed.enter_context(ours)
            for end in (ours, theirs):
                end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, LARGEST_PACKET)
            ours.setblocking(False)
            self._errors = os.memfd_create("eitskin-verifier-stderr")
            options = {
                "line": theirs.fileno(), "parent": os.getpid(), "nice": self.place.nice, "idle": self.place.idle,
                "cpus": list(self.place.cpus or os.sched_getaffinity(0)),
            }  # fmt: skip
            self._child.command = [*self.place.program, json.dumps(options)]
            self._child.start(
                stdout=self._errors,
                stderr=self._errors,
                pass_fds=(theirs.fileno(),),
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
            failed.pop_all()
        return ours

    def _ended(self, status: int) -> None:
        size = os.fstat(self._errors).st_size
        text = os.pread(self._errors, LAST_WORDS_BYTES, max(0, size - LAST_WORDS_BYTES)).decode(errors="replace")
        self._child.process = None
        hung = status == -signal.SIGPROF
        self._fail("hung, and was ended" if hung else how_it_ended(status, last_line(text)))

    def _fail(self, why: str) -> None:
        self._close()
        pause_s, failures = self._child.next_pause_s(), self._child.failures
        if failures >= self._max_failures:
            self.state, self.why = FAILED, f"the verifier {why}; {failures} times in a row, so it is not restarted"
            return
        self._due_s = time.monotonic() + pause_s
        self.state, self.why = WAITING, f"the verifier {why}; it starts again in {pause_s:g} s"
        self.ended = self.why

    def _run(self) -> None:
        self._start()  # in the thread that lives as long as the process may: the kernel ends it with this one
        super()._run()
        process = self._child.process
        if process is not None:
            process.kill()  # also if it is stopped; it keeps nothing
            if self._child.wait(EXIT_TIMEOUT_S) is None:
                threading.Thread(target=process.wait, name="verifier-leaves", daemon=True).start()
            self._child.process = None
            self._close()

    def _close(self) -> None:
        if self._errors >= 0:
            os.close(self._errors)
        self._errors = -1

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        if self.line is not None:
            self.line.close()
