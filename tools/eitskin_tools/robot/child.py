"""The process of one skin: started, heard, started again with growing pauses, ended."""

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from typing import IO, Any, Final

from eitskin.robot.config import SkinSettings
from eitskin.robot.described import ProcessState
from eitskin_tools.processes.children import die_with_parent
from eitskin_tools.processes.pauses import Pauses
from eitskin_tools.robot.life import OVERDUE, SILENT_S, Life
from eitskin_tools.robot.words import words_of
from eitskin_tools.service.supervisor import ADDRESS, HANDED_DOWN, INTERVAL, WHOM

BAD_USAGE: Final = 2
"""Exit status that another start cannot change."""

READ: Final = 1 << 16
LONGEST_LINE: Final = 1 << 20

NOT_OURS: Final = (ADDRESS, INTERVAL, WHOM, "JOURNAL_STREAM")
"""Of the environment: what is meant for the supervising process alone."""

Event = dict[str, Any]


class Lines:
    """Cuts a stream that is read without waiting into lines."""

    def __init__(self, stream: IO[bytes]) -> None:
        os.set_blocking(stream.fileno(), False)
        self.stream, self._rest = stream, b""
        self.ended = False
        """Whether nothing more can come."""

    def read(self) -> Iterator[str]:
        """Yield the whole lines that have come; at the end of the stream also what is left."""
        while True:
            try:
                data = os.read(self.stream.fileno(), READ)
            except BlockingIOError:
                return
            if not data:
                self.ended = True
                last, self._rest = self._rest, b""
                if last:
                    yield last.decode(errors="replace")
                return
            *whole, self._rest = (self._rest + data).split(b"\n")
            self._rest = self._rest[-LONGEST_LINE:]
            yield from (line.decode(errors="replace") for line in whole)


class SkinProcess:
    """A skin's process, now and after each new start.

    Args:
        settings: Of the skin.
        pauses: Between starts.
        more: Words of the command line besides.
        program: What runs ``eitskin``; a test gives its own.
        silent_s: How long it may give no sign of life, once it is ready.
    """

    def __init__(
        self,
        settings: SkinSettings,
        pauses: Pauses,
        more: Sequence[str] = (),
        program: Sequence[str] = (sys.executable, "-m", "eitskin_tools.cli"),
        silent_s: float = SILENT_S,
    ) -> None:
        self.settings = settings
        self._pauses, self._words = pauses, [*program, *words_of(settings), *more]
        self.state, self.why, self.status = "starting", "", 0
        self.restarts = 0
        self.due_s: float | None = 0.0
        """When to start next; None while it runs, or if it never is to."""
        self.seen = False
        """Whether it was ready or has ended since the very first start."""
        self.summary: object = None
        self.life: Life | None = None
        self._silent_s = silent_s
        self._failures = 0
        self._ready_s: float | None = None
        self._said = ""
        self._process: subprocess.Popen[bytes] | None = None
        self.errors: Lines | None = None
        self.outputs: Lines | None = None
        self.ended: int = -1
        """A descriptor that is readable once the process has ended; -1 while none runs."""

    @property
    def runs(self) -> bool:
        """Whether there is a process."""
        return self._process is not None

    @property
    def described(self) -> ProcessState:
        """What robot.json says of it."""
        pid = 0 if self._process is None else self._process.pid
        return ProcessState(self.settings.skin, self.state, pid, self.restarts, self.why)

    def start(self) -> None:
        """Start it.

        Raises:
            OSError: There are too few processes, descriptors or memory.
        """
        environment = {"PYTHONFAULTHANDLER": "1"}  # whoever is ended by SIGABRT shows what each thread was doing
        environment |= {name: value for name, value in os.environ.items() if name not in NOT_OURS}
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        with theirs:
            environment[ADDRESS] = f"{HANDED_DOWN}{theirs.fileno()}"
            environment[INTERVAL] = str(round(OVERDUE * self._silent_s * 1e6))
            process = None
            try:
                process = subprocess.Popen(
                    self._words,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    env=environment,
                    pass_fds=(theirs.fileno(),),
                    process_group=0,
                    preexec_fn=die_with_parent,  # noqa: PLW1509 -- no thread runs here, and it is one system call
                )
                self.ended = os.pidfd_open(process.pid)
            except OSError:
                ours.close()
                if process is not None:  # nobody could hear of its end
                    process.kill()
                    process.communicate()
                raise
        self._process = process
        self.life = Life(ours, self._process.pid, self._silent_s)
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self.outputs, self.errors = Lines(self._process.stdout), Lines(self._process.stderr)
        self.state, self.due_s, self._ready_s, self._said = "starting", None, None, ""

    def events(self, now_s: float) -> Iterator[Event]:
        """Yield what it has said: objects of its log; a line that is none is a warning."""
        if self.errors is None:
            return
        for line in self.errors.read():
            if not line.strip():
                continue
            event = _event(line)
            if event["event"] == "ready":
                self.state, self._ready_s, self.seen = "ready", now_s, True
            elif event["event"] in ("error", "warning"):
                self._said = str(event.get("text", ""))
            yield event

    def hear_summary(self) -> None:
        """Keep the one object that it prints at its end."""
        for line in self.outputs.read() if self.outputs is not None else ():
            try:
                self.summary = json.loads(line)
            except ValueError:
                continue

    def reap(self, now_s: float, *, ending: bool) -> None:
        """Take note of its end, and plan the next start.

        Args:
            now_s: On the clock of ``due_s``.
            ending: Everything ends, so nothing is started again.
        """
        process = self._process
        assert process is not None
        self.status = process.wait()
        for lines in (self.errors, self.outputs):
            if lines is not None:
                lines.stream.close()
        os.close(self.ended)
        forced = self.life is not None and self.life.forced
        if self.life is not None:
            self._said = self.life.why if forced else self._said
            self.life.close()
        self._process, self.errors, self.outputs, self.life, self.ended, self.seen = None, None, None, None, -1, True
        failed = self.status != 0 or forced
        self.why = _how(self.status, self._said) if failed and not ending else "" if ending else "ended by itself"
        if self._ready_s is not None and now_s - self._ready_s >= self._pauses.settled_s:
            self._failures = 0
        wanted = self.settings.restart
        again = (wanted == "always" or (wanted == "on-failure" and failed)) and self.status != BAD_USAGE
        if ending or not again:
            self.state, self.due_s = "failed" if failed and not ending else "ended", None
            return
        self._failures += 1
        self.state, self.due_s = "waiting", now_s + self._pauses.after(self._failures)

    def put_off(self, due_s: float, why: str) -> None:
        """Take note that it could not be started, and when to try again."""
        self.state, self.why, self.due_s, self.seen = "waiting", why, due_s, True

    def restart(self) -> None:
        """Start it once more."""
        self.restarts += 1
        self.start()

    def wait(self, timeout_s: float) -> bool:
        """Wait for its end; return whether it came."""
        try:
            if self._process is not None:
                self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def signal(self, number: int) -> None:
        """Send it a signal."""
        if self._process is not None and self._process.returncode is None:
            signal.pidfd_send_signal(self.ended, number)


def _event(line: str) -> Event:
    try:
        found = json.loads(line)
    except ValueError:
        found = None
    if not isinstance(found, dict) or not isinstance(found.get("event"), str):
        return {"event": "warning", "text": line.strip()}
    return found


def _how(status: int, said: str) -> str:
    how = f"by signal {-status} ({signal.strsignal(-status)})" if status < 0 else f"with status {status}"
    return f"ended {how}" + (f": {said}" if said else ", and said nothing")
