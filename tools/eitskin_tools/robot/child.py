"""The process of one skin: started, listened to, watched for signs of life, started again after growing pauses, ended.

What watches the frame loop within a process needs the interpreter, which C code may keep for ever. So the process also
gives signs of life, as it gives them to systemd: only while its frame loop reads, computes and reads again, or waits
for its line, and only from Python. They come over a pair of sockets that nobody else can reach.
"""

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any, Final

from eitskin.robot.config import SkinSettings
from eitskin.robot.described import ProcessState
from eitskin_tools.processes.children import Backoff, ChildProcess, die_with_parent, how_it_ended
from eitskin_tools.service.supervisor import ADDRESS, HANDED_DOWN, INTERVAL, WHOM

BAD_USAGE: Final = 2
"""Exit status that another start cannot change."""

READ: Final = 1 << 16
LONGEST_LINE: Final = 1 << 20

NOT_OURS: Final = (ADDRESS, INTERVAL, WHOM, "JOURNAL_STREAM")
"""Of the environment: what is meant for the supervising process alone."""

SILENT_S: Final = 10.0
"""How long a skin that is ready may give no sign of life. Its own watchdog ends it after 2 s, takes 1 s at most to say
why, and the last sign is up to 2 s old when the loop stops: so the process speaks first wherever it can."""

ENDING_S: Final = 8.0
"""The least of the same for one that has said that it ends: it ends itself after 5 s, whatever hangs."""

SIGN_OF: Final = 0.4
"""Part of the longest silence that is asked for as the interval of its signs."""

LOOKS: Final = 10
"""Looks in the longest silence."""

PAUSE_S: Final = 1.0
"""Between a signal and the next, stronger one."""

FORCE: Final = (signal.SIGTERM, signal.SIGABRT, signal.SIGKILL)
"""By the second one Python shows what each thread is doing, without the interpreter's lock, and the process ends."""

LARGEST_SIGN: Final = 4096

STOPPED: Final = "Tt"
"""States of a process that was stopped, by a signal or by a debugger."""

Event = dict[str, Any]


class SignsOfLife:
    """The signs of life of one process.

    Args:
        ear: Where they are heard.
        pid: Whose they are.
        silent_s: Longest time without one, once it is ready.
    """

    def __init__(self, ear: socket.socket, pid: int, silent_s: float = SILENT_S) -> None:
        ear.setblocking(False)
        self.ear, self._silent_s = ear, silent_s
        self._stat = Path(f"/proc/{pid}/stat")
        self.due_s: float | None = None
        """When to look; None before it is ready: starting takes as long as it takes."""
        self.forced = False
        """Whether it was told to end because it gave no sign."""
        self._limit_s = silent_s
        self._looks = self._tried = 0

    def hear(self, now_s: float) -> None:
        """Take what has come."""
        while True:
            try:
                lines = self.ear.recv(LARGEST_SIGN).split(b"\n")
            except OSError:  # nothing more, for now or for good
                return
            if b"READY=1" in lines or b"STOPPING=1" in lines or (b"WATCHDOG=1" in lines and self.due_s is not None):
                if b"STOPPING=1" in lines:
                    self._limit_s = max(self._limit_s, ENDING_S)
                self._looks = self._tried = 0
                self.due_s = now_s + self._limit_s / LOOKS

    def look(self, now_s: float) -> signal.Signals | None:
        """Look, when it is due, whether it has been silent for too long.

        Looks are counted, not seconds: a supervising process that was stopped has not looked either. A look at a
        process that is stopped does not count.

        Returns:
            What to send it now: what is stronger each time.
        """
        if self.due_s is None or now_s < self.due_s:
            return None
        self.due_s = now_s + self._limit_s / LOOKS
        if not self._tried:
            self._looks += not self._is_stopped()
            if self._looks < LOOKS:
                return None
        number = FORCE[min(self._tried, len(FORCE) - 1)]
        self._tried, self.forced, self.due_s = self._tried + 1, True, now_s + PAUSE_S
        return number

    def _is_stopped(self) -> bool:
        try:
            return self._stat.read_text().rpartition(")")[2].split()[0] in STOPPED
        except OSError:  # it has just ended
            return True

    @property
    def why(self) -> str:
        """For people: why it is ended."""
        what = "its frame loop" if self._limit_s == self._silent_s else "its end"
        return f"no sign of life for {self._limit_s:g} s: {what} stands still, and nothing in the process can say so"

    def close(self) -> None:
        """Hear no more."""
        self.ear.close()


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
        backoff: Pauses between starts.
        more: Words of the command line besides.
        program: What runs ``eitskin``; a test gives its own.
        silent_s: How long it may give no sign of life, once it is ready.
    """

    def __init__(
        self,
        settings: SkinSettings,
        backoff: Backoff,
        more: Sequence[str] = (),
        program: Sequence[str] = (sys.executable, "-m", "eitskin_tools.cli"),
        silent_s: float = SILENT_S,
    ) -> None:
        self.settings = settings
        self._child = ChildProcess([*program, *command_line_of(settings), *more], backoff)
        self.state, self.why, self.status = "starting", "", 0
        self.due_s: float | None = 0.0
        """When to start next; None while it runs, or if it never is to."""
        self.seen = False
        """Whether it was ready or has ended since the very first start."""
        self.summary: object = None
        self.life: SignsOfLife | None = None
        self._silent_s = silent_s
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
        environment = {"PYTHONFAULTHANDLER": "1"}  # whoever is ended by SIGABRT shows what each thread was doing
        environment |= {name: value for name, value in os.environ.items() if name not in NOT_OURS}
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        with theirs:
            environment[ADDRESS] = f"{HANDED_DOWN}{theirs.fileno()}"
            environment[INTERVAL] = str(round(SIGN_OF * self._silent_s * 1e6))
            process = None
            try:
                process = self._child.start(
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    env=environment,
                    pass_fds=(theirs.fileno(),),
                    preexec_fn=die_with_parent,  # no thread runs here, and it is one system call
                )
                self.ended = os.pidfd_open(process.pid)
            except OSError:
                ours.close()
                if process is not None:  # nobody could hear of its end
                    process.kill()
                    process.communicate()
                self._child.process = None
                raise
        self.life = SignsOfLife(ours, process.pid, self._silent_s)
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
        process = self._child.process
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
        self._child.process = self.errors = self.outputs = self.life = None
        self.ended, self.seen = -1, True
        failed = self.status != 0 or forced
        if ending:
            self.why = ""
        else:
            self.why = how_it_ended(self.status, self._said or "it said nothing") if failed else "ended by itself"
        if self._ready_s is not None and now_s - self._ready_s >= self._child.backoff.settled_s:
            self._child.failures = 0
        wanted = self.settings.restart
        again = (wanted == "always" or (wanted == "on-failure" and failed)) and self.status != BAD_USAGE
        if ending or not again:
            self.state, self.due_s = "failed" if failed and not ending else "ended", None
            return
        self.state, self.due_s = "waiting", now_s + self._child.next_pause_s()

    def put_off(self, due_s: float, why: str) -> None:
        """Take note that it could not be started, and when to try again."""
        self.state, self.why, self.due_s, self.seen = "waiting", why, due_s, True

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
    }
    found += [f"--{name}={value}" for name, value in valued.items() if value is not None]
    found += [f"--exclude-electrode={number}" for number in settings.exclude_electrodes]
    truths = {"every-map": settings.every_map, "mlock": settings.realtime.mlock}
    found += [f"--{name}" for name, value in truths.items() if value]
    if settings.compensate_drift is not None:
        found.append("--compensate-drift" if settings.compensate_drift else "--no-compensate-drift")
    return found
