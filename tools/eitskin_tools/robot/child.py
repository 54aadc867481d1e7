"""The process of one skin: starts it, reads its output, restarts it after growing pauses, ends it."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from typing import IO, Any, Final

from eitskin.robot.config import SkinSettings
from eitskin.robot.described import ProcessState
from eitskin_tools.processes.children import Backoff, ChildProcess, die_with_parent, how_it_ended
from eitskin_tools.service.supervisor import ADDRESS_VARIABLE, HANG_VARIABLE, INTERVAL_VARIABLE, PID_VARIABLE

BAD_USAGE: Final = 2
"""Exit status that another start cannot change."""

READ_BYTES: Final = 1 << 16
READS: Final = 4
"""Blocks read at once: all that a pipe holds, and its end."""

MAX_LINE_BYTES: Final = 1 << 20

SUPERVISOR_VARIABLES: Final = (ADDRESS_VARIABLE, INTERVAL_VARIABLE, PID_VARIABLE, "JOURNAL_STREAM")
"""Of the environment: what is meant for the supervising process alone."""

HANG_S: Final = 10.0
"""How long a frame loop may stand still before the process ends without Python. Its own watchdog ends it after 2 s, if
any Python runs."""

Event = dict[str, Any]


class Lines:
    """Cuts a stream that is read without waiting into lines."""

    def __init__(self, stream: IO[bytes]) -> None:
        os.set_blocking(stream.fileno(), False)
        self.stream, self._rest = stream, b""
        self.ended = False
        """Whether nothing more can come."""

    def read(self) -> Iterator[str]:
        """Yield the whole lines that have come; at the end of the stream also what is left.

        No more than ``READS`` blocks a call: a child that never stops printing would keep its reader for ever.
        """
        for _ in range(READS):
            try:
                data = os.read(self.stream.fileno(), READ_BYTES)
            except BlockingIOError:
                return
            if not data:
                self.ended = True
                last, self._rest = self._rest, b""
                if last:
                    yield last.decode(errors="replace")
                return
            *whole, self._rest = (self._rest + data).split(b"\n")
            self._rest = self._rest[-MAX_LINE_BYTES:]
            yield from (line.decode(errors="replace") for line in whole)


class SkinProcess:
    """A skin's process and its restarts.

    Args:
        settings: Of the skin.
        backoff: Pauses between starts.
        more: Additional words of the command line.
        program: What runs ``eitskin``; a test gives its own.
        hang_s: How long its frame loop may stand still, once it is ready.
    """

    def __init__(
        self,
        settings: SkinSettings,
        backoff: Backoff,
        more: Sequence[str] = (),
        program: Sequence[str] = (sys.executable, "-m", "eitskin_tools.cli"),
        hang_s: float = HANG_S,
    ) -> None:
        self.settings = settings
        self._child = ChildProcess([*program, *command_line_of(settings), *more], backoff)
        self.state, self.why, self.status = "starting", "", 0
        self.due_s: float | None = 0.0
        """When to start next; None while it runs, or if it never is to."""
        self.reported = False
        """Whether it was ready or has ended since the very first start."""
        self.summary: object = None
        self._hang_s = hang_s
        self._ready_s: float | None = None
        self._said = ""
        self.errors: Lines | None = None
        self.outputs: Lines | None = None
        self.ended: int = -1
        """A descriptor that is readable once the process has ended; -1 while none runs."""

    @property
    def runs(self) -> bool:
        """Whether there is a process."""
        return self._child.process is not None

    @property
    def restarts(self) -> int:
        """New starts since the first."""
        return self._child.restarts

    @property
    def described(self) -> ProcessState:
        """What robot.json says of it."""
        return ProcessState(self.settings.skin, self.state, self._child.pid, self.restarts, self.why)

    def start(self) -> None:
        """Start it.

        Raises:
            OSError: There are too few processes, descriptors or memory.
        """
        environment = {"PYTHONFAULTHANDLER": "1"}  # a child that SIGABRT ends shows its stacks
        environment |= {name: value for name, value in os.environ.items() if name not in SUPERVISOR_VARIABLES}
        environment[HANG_VARIABLE] = str(self._hang_s)
        process = self._child.start(
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
            preexec_fn=die_with_parent,  # no thread runs here, and it is one system call
        )
        try:
            self.ended = os.pidfd_open(process.pid)
        except OSError:  # its end could not be reported
            process.kill()
            process.communicate()
            self._child.process = None
            raise
        assert process.stdout is not None
        assert process.stderr is not None
        self.outputs, self.errors = Lines(process.stdout), Lines(process.stderr)
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
                self.state, self._ready_s, self.reported = "ready", now_s, True
            elif event["event"] in ("error", "warning"):
                self._said = str(event.get("text", ""))
            yield event

    def read_summary(self) -> None:
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
        process = self._child.process
        assert process is not None
        self.status = process.wait()
        for lines in (self.errors, self.outputs):
            if lines is not None:
                lines.stream.close()
        os.close(self.ended)
        self._child.process = self.errors = self.outputs = None
        self.ended, self.reported = -1, True
        failed = self.status != 0
        if ending:
            self.why = ""
        else:
            self.why = how_it_ended(self.status, self._said or "it printed nothing") if failed else "ended by itself"
        if self._ready_s is not None and now_s - self._ready_s >= self._child.backoff.settled_s:
            self._child.failures = 0
        wanted = self.settings.restart
        again = (wanted == "always" or (wanted == "on-failure" and failed)) and self.status != BAD_USAGE
        if ending or not again:
            self.state, self.due_s = "failed" if failed and not ending else "ended", None
            return
        self.state, self.due_s = "waiting", now_s + self._child.next_pause_s()

    def postpone(self, due_s: float, why: str) -> None:
        """Take note that it could not be started, and when to try again."""
        self.state, self.why, self.due_s, self.reported = "waiting", why, due_s, True

    def restart(self) -> None:
        """Start it once more."""
        self._child.restarts += 1
        self.start()

    def wait(self, timeout_s: float) -> bool:
        """Wait for its end; return whether it came."""
        return not self.runs or self._child.wait(timeout_s) is not None

    def signal(self, number: int) -> None:
        """Send it a signal."""
        process = self._child.process
        if process is not None and process.returncode is None:
            signal.pidfd_send_signal(self.ended, number)


def _event(line: str) -> Event:
    try:
        found = json.loads(line)
    except ValueError:
        found = None
    if not isinstance(found, dict) or not isinstance(found.get("event"), str):
        return {"event": "warning", "text": line.strip()}
    return found


def command_line_of(settings: SkinSettings) -> list[str]:
    """Return the command line of ``eitskin run`` for a skin of robot.toml, without the program."""
    found = ["run", f"--port={settings.port}", "--log-format=json"]
    found += [f"--publish={settings.skin.publish}", f"--control={settings.skin.control}"]
    valued = {
        "baud": settings.baud,
        "reconnect": settings.reconnect_s,
        "bundle": settings.bundle,
        "touches": settings.touches,
        "skin": settings.description,
        "curve-keys": settings.curve_keys,
        "reference": settings.reference,
        "reference-frames": settings.reference_frames,
        "budget-ms": settings.budget_ms,
        "solver": settings.solver,
        "idle-after": settings.idle_after_s,
        "sched-fifo": settings.realtime.sched_fifo,
        "affinity": ",".join(map(str, settings.realtime.affinity)) or None,
        "verify": None if settings.verify.mode == "off" else settings.verify.mode,
        "verify-budget-ms": settings.verify.budget_ms,
        "verify-nice": settings.verify.nice,
        "verify-affinity": ",".join(map(str, settings.verify.affinity)) or None,
        "cloud": None if settings.verify.mode == "off" else settings.verify.cloud,
    }
    found += [f"--{name}={value}" for name, value in valued.items() if value is not None]
    found += [f"--exclude-electrode={number}" for number in settings.exclude_electrodes]
    truths = {"every-map": settings.every_map, "mlock": settings.realtime.mlock}
    found += [f"--{name}" for name, value in truths.items() if value]
    if settings.compensate_drift is not None:
        found.append("--compensate-drift" if settings.compensate_drift else "--no-compensate-drift")
    return found
