"""Keeps the verifier's process: starts it, sees it die or hang, starts it again with growing pauses, gives up, ends it.

Looks are counted, not seconds: where this process was stopped, or got no core, the verifier is not blamed for it.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Final

from eitskin.messaging.verified.message import FAILED, STARTING, WAITING
from eitskin_tools.processes.lookout import Lookout
from eitskin_tools.processes.pauses import Pauses
from eitskin_tools.verifier.letters import LARGEST_ANSWER
from eitskin_tools.verifier.mailbox import FRAME, Mailbox

LOOK_S: Final = 0.1

STILL_S: Final = 10.0
"""Without a beat for so long it hangs; a busy machine may keep its core for a second."""

IDLE_STILL_S: Final = 30.0
"""The same of one that runs only while nothing else wants the core."""

HANGS_S: Final = 60.0
"""So far beyond what it may take, in time that it had, what is computed hangs. Amid a frame the model of its surface
may be made anew, which counts beside its budget, and a small computer takes many times as long as others."""

LATE_S: Final = 1.0
"""So far beyond it is said."""

LEAVES_S: Final = 0.2
"""How long its end is waited for by who leaves. It needs a core to end as well, which one that runs at the lowest
priority may not get for seconds; who is killed keeps nothing, and the kernel sees to the rest."""

MOST_FAILURES: Final = 5
"""In a row, after which it is given up."""

LAST_WORDS: Final = 4096
"""Bytes of its standard error that are looked at."""


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


class Keeper(Lookout):
    """Keeps a verifier from when it is entered to when it is left.

    Args:
        place: Where it runs.
        pauses: Between starts.
        still_s: Without a beat for so long it hangs.
        most_failures: In a row, after which it is given up.
        hangs_s: So far beyond what it may take, what is computed hangs.
    """

    def __init__(
        self,
        place: Place,
        pauses: Pauses | None = None,
        still_s: float = STILL_S,
        most_failures: int = MOST_FAILURES,
        hangs_s: float = HANGS_S,
    ) -> None:
        super().__init__("verifier-keeper", LOOK_S)
        self.place, self._pauses = place, pauses or Pauses()
        self._most_looks, self._most_failures = round(still_s / LOOK_S), most_failures
        self.hangs_s = hangs_s
        self.mailbox = Mailbox.made()
        self.bell = os.eventfd(0, os.EFD_NONBLOCK)
        self.answers: socket.socket | None = None
        """Where the present process answers; another object for another process."""
        self.state, self.why = STARTING, ""
        """``starting`` while a process is there, else ``waiting`` or ``failed``, and why."""
        self.ended = ""
        """What became of the last process that there was, for who looks only once another one runs."""
        self.restarts = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._errors = -1
        self._failures = self._beat = self._still_looks = self._looks = self._wait_looks = 0
        self._hung = False
        self.is_late = False
        """Whether what it computes takes longer than it may."""

    @property
    def pid(self) -> int:
        """Of the process; 0 while none runs."""
        process = self._process
        return 0 if process is None else process.pid

    def ring(self) -> None:
        """Tell the process that there is a letter."""
        with suppress(BlockingIOError):
            os.eventfd_write(self.bell, 1)

    def look(self) -> None:
        """See whether it lives, and start it when it is time."""
        process = self._process
        if process is None:
            if self.state == WAITING:
                self._wait_looks -= 1
                if self._wait_looks <= 0:
                    self.restarts += 1
                    self._start()
            return
        if process.poll() is not None:
            self._ended(process)
            return
        late_s = self.mailbox.late_s
        self.is_late = late_s > LATE_S
        self._looks += not self.is_late  # who hangs again and again never settles
        beat = self.mailbox.beat
        self._still_looks = self._still_looks + 1 if beat == self._beat else 0
        self._beat = beat
        if self._still_looks >= self._most_looks or late_s > self.hangs_s:
            self._hung = True
            process.kill()  # a later look sees it ended: one that runs only while nothing else does may take a while
        elif self._looks * LOOK_S >= self._pauses.settled_s:
            self._failures = 0

    def _start(self) -> None:
        self._still_looks = self._looks = 0
        self._hung = self.is_late = False
        self.mailbox.late_s = 0.0
        try:
            self.answers = self._started()
        except OSError as error:  # too few processes or descriptors: another time
            self._fail(f"cannot be started: {error.strerror or error}")
        else:
            self.state, self.why = STARTING, ""

    def _started(self) -> socket.socket:
        """Start the process, and return where it answers.

        Raises:
            OSError: It cannot be started.
        """
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with ExitStack() as left, theirs:
            left.enter_context(ours)
            for end in (ours, theirs):
                end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 * LARGEST_ANSWER)
            ours.setblocking(False)
            self._errors = os.memfd_create("eitskin-verifier-stderr")
            told = {
                "memory": self.mailbox.descriptor, "bell": self.bell, "answers": theirs.fileno(), "parent": os.getpid(),
                "nice": self.place.nice, "idle": self.place.idle, "skip": self.mailbox.written[FRAME],
                "cpus": list(self.place.cpus or os.sched_getaffinity(0)),
            }  # fmt: skip
            self._process = subprocess.Popen(
                [*self.place.program, json.dumps(told)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._errors,
                pass_fds=(self.mailbox.descriptor, self.bell, theirs.fileno()),
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
                process_group=0,
            )
            left.pop_all()
        return ours

    def _ended(self, process: subprocess.Popen[bytes]) -> None:
        status = process.returncode
        how = f"by signal {-status} ({signal.strsignal(-status)})" if status < 0 else f"with status {status}"
        said = self._last_words()
        self._process = None
        self._fail("hung, and was ended" if self._hung else f"ended {how}" + (f": {said}" if said else ""))

    def _fail(self, why: str) -> None:
        if self._errors >= 0:
            os.close(self._errors)
            self._errors = -1
        self._failures += 1
        if self._failures >= self._most_failures:
            self.state, self.why = FAILED, f"the verifier {why}; {self._failures} times in a row, so it is given up"
            return
        pause_s = self._pauses.after(self._failures)
        self._wait_looks = round(pause_s / LOOK_S)
        self.state, self.why = WAITING, f"the verifier {why}; it starts again in {pause_s:g} s"
        self.ended = self.why

    def _last_words(self) -> str:
        size = os.fstat(self._errors).st_size
        text = os.pread(self._errors, LAST_WORDS, max(0, size - LAST_WORDS)).decode(errors="replace")
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        return lines[-1] if lines else ""

    def _run(self) -> None:
        self._start()  # in the thread that lives as long as the process may: the kernel ends it with this one
        super()._run()
        process = self._process
        if process is not None:
            process.kill()  # also if it is stopped; it keeps nothing
            try:
                process.wait(LEAVES_S)
            except subprocess.TimeoutExpired:
                threading.Thread(target=process.wait, name="verifier-leaves", daemon=True).start()
            self._process = None
            os.close(self._errors)

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        if self.answers is not None:
            self.answers.close()
        self.mailbox.close()
        os.close(self.bell)
