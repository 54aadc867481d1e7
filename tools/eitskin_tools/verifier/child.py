"""The verifier's process as the runtime sees it: started, watched, started again after growing pauses, given up, ended.

It watches by counting looks, not seconds: while this process was stopped, or got no core, the verifier is not blamed.
"""

import json
import os
import socket
import sys
import threading
from contextlib import ExitStack
from dataclasses import dataclass
from struct import Struct
from typing import Final

from eitskin.messaging.streams.verified import FAILED, STARTING, WAITING
from eitskin_tools.processes.children import Backoff, ChildProcess, how_it_ended, last_line
from eitskin_tools.processes.periodic_thread import PeriodicThread
from eitskin_tools.verifier.letters import LARGEST_PACKET

LOOK_S: Final = 0.1
"""Between two looks."""

STILL_S: Final = 10.0
"""A verifier without a beat for so long hangs; a busy machine may keep its core for a second."""

IDLE_STILL_S: Final = 30.0
"""The same for one that runs only while nothing else wants the core."""

HANGS_S: Final = 60.0
"""A computation that is over its budget by so much hangs, counted in time that it had. A frame may need a new model
of its surface, which counts beside its budget, and a small computer is many times slower than others."""

LATE_S: Final = 1.0
"""A computation that is over its budget by so much is reported as late."""

LEAVES_S: Final = 0.2
"""How long leaving waits for its end. It needs a core to end as well, which it may not get for seconds at the lowest
priority; a killed verifier keeps nothing, and the kernel sees to the rest."""

MAX_FAILURES: Final = 5
"""In a row, after which it is given up."""

LAST_WORDS_BYTES: Final = 4096
"""Of its standard error that are read."""


BEAT: Final = Struct("<d")
"""A beat in the pipe: seconds that what is computed takes beyond what it may; 0 while it is in time."""


@dataclass(frozen=True, slots=True)
class Place:
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
        still_s: Without a beat for so long it hangs.
        max_failures: In a row, after which it is given up.
        hangs_s: So far beyond what it may take, what is computed hangs.
    """

    def __init__(
        self,
        place: Place,
        backoff: Backoff | None = None,
        still_s: float = STILL_S,
        max_failures: int = MAX_FAILURES,
        hangs_s: float = HANGS_S,
    ) -> None:
        super().__init__("verifier-process", LOOK_S)
        self.place = place
        self._child = ChildProcess(place.program, backoff)
        self._max_looks, self._max_failures = round(still_s / LOOK_S), max_failures
        self.hangs_s = hangs_s
        self.line: socket.socket | None = None
        """To the present process, for who sends frames and closes it; another object for another process."""
        self._beats = -1
        self.state, self.why = STARTING, ""
        """``starting`` while a process is there, else ``waiting`` or ``failed``, and why."""
        self.ended = ""
        """What became of the last process that there was, for who looks only once another one runs."""
        self._errors = -1
        self._still_looks = self._looks = self._wait_looks = 0
        self._hung = False
        self.is_late = False
        """Whether what it computes takes longer than it may."""

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
            if self.state == WAITING:
                self._wait_looks -= 1
                if self._wait_looks <= 0:
                    self._child.restarts += 1
                    self._start()
            return
        if process.poll() is not None:
            self._ended(process.returncode)
            return
        late_s = self._heard()
        self._still_looks = self._still_looks + 1 if late_s is None else 0
        late_s = late_s or 0.0
        self.is_late = late_s > LATE_S
        self._looks += not self.is_late  # who hangs again and again never settles
        if self._still_looks >= self._max_looks or late_s > self.hangs_s:
            self._hung = True
            process.kill()  # a later look sees it ended: one that runs only while nothing else does may take a while
        elif self._looks * LOOK_S >= self._child.backoff.settled_s:
            self._child.failures = 0

    def _heard(self) -> float | None:
        """Return how late it is by the last beat since the last look; None without one."""
        try:
            beats = os.read(self._beats, 4096)
        except BlockingIOError:
            return None
        return float(BEAT.unpack(beats[-BEAT.size :])[0]) if beats else None  # at its end there is nothing to read

    def _start(self) -> None:
        self._still_looks = self._looks = 0
        self._hung = self.is_late = False
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
            self._beats, beats = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
            try:
                options = {
                    "line": theirs.fileno(), "beats": beats, "parent": os.getpid(), "nice": self.place.nice,
                    "idle": self.place.idle, "cpus": list(self.place.cpus or os.sched_getaffinity(0)),
                }  # fmt: skip
                self._child.command = [*self.place.program, json.dumps(options)]
                self._child.start(
                    stdout=self._errors,
                    stderr=self._errors,
                    pass_fds=(theirs.fileno(), beats),
                    env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
                )
            finally:
                os.close(beats)
            failed.pop_all()
        return ours

    def _ended(self, status: int) -> None:
        size = os.fstat(self._errors).st_size
        text = os.pread(self._errors, LAST_WORDS_BYTES, max(0, size - LAST_WORDS_BYTES)).decode(errors="replace")
        self._child.process = None
        self._fail("hung, and was ended" if self._hung else how_it_ended(status, last_line(text)))

    def _fail(self, why: str) -> None:
        self._close()
        pause_s, failures = self._child.next_pause_s(), self._child.failures
        if failures >= self._max_failures:
            self.state, self.why = FAILED, f"the verifier {why}; {failures} times in a row, so it is given up"
            return
        self._wait_looks = round(pause_s / LOOK_S)
        self.state, self.why = WAITING, f"the verifier {why}; it starts again in {pause_s:g} s"
        self.ended = self.why

    def _run(self) -> None:
        self._start()  # in the thread that lives as long as the process may: the kernel ends it with this one
        super()._run()
        process = self._child.process
        if process is not None:
            process.kill()  # also if it is stopped; it keeps nothing
            if self._child.wait(LEAVES_S) is None:
                threading.Thread(target=process.wait, name="verifier-leaves", daemon=True).start()
            self._child.process = None
            self._close()

    def _close(self) -> None:
        for descriptor in (self._errors, self._beats):
            if descriptor >= 0:
                os.close(descriptor)
        self._errors = self._beats = -1

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        if self.line is not None:
            self.line.close()
