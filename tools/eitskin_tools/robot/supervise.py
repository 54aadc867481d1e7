"""The supervisor of the skins' processes: starts them, reads their output, restarts those that ended, ends them all.

It waits in one place for whatever comes first: a line from a skin, the end of a process, a signal, the time of a
restart or of a watchdog message to systemd. The failure of one skin does not affect the others.
"""

import os
import selectors
import signal
import socket
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Final

from eitskin.robot.described import FILE, write_states
from eitskin_proto.files.writing import held
from eitskin_tools.console.run_log import RunLog
from eitskin_tools.console.run_status import Status
from eitskin_tools.processes.signals import endings
from eitskin_tools.robot.child import SkinProcess
from eitskin_tools.service.supervisor import Supervisor

GRACE_S: Final = 6.0
"""Longest time for a skin to end after the signal: it ends by itself within 5 s, whatever hangs (the watchdog of
``eitskin run``), and mostly within some tens of milliseconds."""

MAX_WAIT_S: Final = 60.0


class RobotLog:
    """Writes events of several skins.

    Args:
        log: Where they go.
    """

    def __init__(self, log: RunLog) -> None:
        self._log = log

    def event(self, name: str, event: Mapping[str, Any]) -> None:
        """Report what a skin said: an object of its log."""
        kind = str(event["event"])
        fields = {key: value for key, value in event.items() if key not in ("event", "time_utc")}
        self._log.event(kind, f"eitskin run: {name}: {_event_text(kind, fields)}", {"skin": name, **fields})

    def warn(self, name: str, text: str, kind: str = "warning") -> None:
        """Report something that is wrong; an ``error`` is the end of a skin's process before its time."""
        self._log.event(kind, f"eitskin run: {name}: {text}", {"skin": name, "text": text})

    def ready(self, folder: Path, names: Sequence[str], count: int) -> None:
        """Report that every skin was ready or has failed once."""
        text = f"ready {len(names)} of {count} skins publish, folder {folder}: {', '.join(names) or 'none'}"
        self._log.event("ready", text, {"folder": str(folder), "skins": list(names), "of": count})


def _event_text(kind: str, fields: Mapping[str, Any]) -> str:
    """Return what people read of an event."""
    if kind == "ready":
        return f"publishing on {fields.get('publish')} control {fields.get('control')}"
    if kind == "status" and isinstance(rate := fields.get("rate_hz"), int | float):
        return Status(float(rate), fields.get("touched"), fields).text()
    stacks = fields.get("stacks")
    more = "".join(f" | {line}" for line in stacks) if isinstance(stacks, list) else ""
    return f"{fields.get('text', '')}{more}"


class SkinSupervisor:
    """The processes of a robot's skins.

    Args:
        folder: Where their state is written.
        skins: Not started.
        log: Gets their output.
        supervisor: The process that started this one, such as systemd.
        grace_s: How long ending may take before force is used.
    """

    def __init__(
        self,
        folder: Path,
        skins: Sequence[SkinProcess],
        log: RobotLog,
        supervisor: Supervisor,
        grace_s: float = GRACE_S,
    ) -> None:
        self._folder, self.skins, self._log, self._supervisor = folder, tuple(skins), log, supervisor
        self._grace_s = grace_s
        self._ending = False
        self._kill_s: float | None = None
        self._reported_ready = False
        self._sign_s = None if supervisor.interval_s is None else supervisor.interval_s / 2.0
        self._next_sign_s = 0.0
        self._selector = selectors.DefaultSelector()

    def run(self) -> int:
        """Run until stopped by SIGTERM, SIGINT or SIGHUP, or until no skin is left; return the exit status.

        Raises:
            HeldError: Another process runs skins in the folder.
        """
        with ExitStack() as stack:
            stack.callback(self._selector.close)
            who = "another 'eitskin run --config' runs skins there"
            stack.enter_context(held(self._folder, who, "stop it, or state another folder"))
            stack.callback(self._remove_states)
            self._watch_signals(stack)
            stack.callback(self._end_all)
            for one in self.skins:
                self._start(one)
            self._write()
            self._report()
            while any(one.runs or one.due_s is not None for one in self.skins):
                self._turn()
        failed = [one for one in self.skins if one.state == "failed"]
        return 1 if failed and not self._ending else 0

    def stop(self) -> None:
        """Have every skin end; none is started again."""
        if self._ending:
            return
        self._ending = True
        self._supervisor.stopping()
        self._kill_s = time.monotonic() + self._grace_s
        for one in self.skins:
            if one.runs:
                one.signal(signal.SIGTERM)
                one.signal(signal.SIGCONT)  # a stopped process receives the other one only then
            elif one.due_s is not None:
                one.due_s, one.state = None, "failed"

    def _turn(self) -> None:
        for key, _ in self._selector.select(self._wait_s()):
            key.data(key.fileobj)
        now_s = time.monotonic()
        if self._kill_s is not None and now_s >= self._kill_s:
            self._kill_s = None
            for one in self.skins:
                one.signal(signal.SIGKILL)
        for one in self.skins:
            if one.due_s is not None and not one.runs and now_s >= one.due_s and not self._ending:
                self._start(one)
                self._write()
        if self._sign_s is not None and now_s >= self._next_sign_s:
            self._next_sign_s = now_s + self._sign_s
            self._supervisor.alive()

    def _wait_s(self) -> float:
        due = [one.due_s for one in self.skins if one.due_s is not None and not one.runs]
        due += [] if self._kill_s is None else [self._kill_s]
        due += [] if self._sign_s is None else [self._next_sign_s]
        return max(0.0, min([at_s - time.monotonic() for at_s in due] + [MAX_WAIT_S]))

    def _start(self, one: SkinProcess) -> None:
        first = one.due_s == 0.0 and not one.reported
        try:
            one.start() if first else one.restart()
        except OSError as error:  # too few processes or descriptors: another time
            one.postpone(time.monotonic() + MAX_WAIT_S, f"cannot be started: {error.strerror or error}")
            self._log.warn(one.settings.name, one.why)
            return
        assert one.errors is not None
        assert one.outputs is not None
        self._selector.register(one.errors.stream, selectors.EVENT_READ, lambda _: self._read_output(one))
        self._selector.register(one.outputs.stream, selectors.EVENT_READ, lambda _: self._read_output(one))
        self._selector.register(one.ended, selectors.EVENT_READ, lambda _: self._ended(one))

    def _read_output(self, one: SkinProcess) -> None:
        if not one.runs:
            return
        one.read_summary()
        for event in one.events(time.monotonic()):
            if event["event"] == "ready":
                self._write()  # before the line is printed, so that its reader finds the file
            self._log.event(one.settings.name, event)
            if event["event"] == "ready":
                self._report()
        for lines in (one.errors, one.outputs):  # at its end a stream would be readable for ever
            if lines is not None and lines.ended:
                with suppress(KeyError):
                    self._selector.unregister(lines.stream)

    def _ended(self, one: SkinProcess) -> None:
        if not one.runs:
            return
        self._read_output(one)
        self._selector.unregister(one.ended)
        for lines in (one.errors, one.outputs):
            with suppress(KeyError):
                self._selector.unregister(lines.stream if lines is not None else -1)
        now_s = time.monotonic()
        one.reap(now_s, ending=self._ending)
        self._write()
        if one.state in ("failed", "waiting") and one.why:
            next_s = "" if one.due_s is None else f"; starts again in {one.due_s - now_s:.3g} s"
            others = sum(other.runs for other in self.skins)
            said = f"{one.why}{next_s}; {others} of {len(self.skins)} skins run on"
            self._log.warn(one.settings.name, said, kind="error")
        self._report()

    def _write(self) -> None:
        """Write down how the skins are; a full disk stops no skin."""
        try:
            write_states(self._folder, os.getpid(), [one.described for one in self.skins])
        except OSError as error:
            self._log.warn("all", f"{self._folder / FILE} cannot be written: {error.strerror or error}")

    def _report(self) -> None:
        """Tell systemd how the skins are, and once that all were ready or have failed."""
        ready = [one.settings.name for one in self.skins if one.state == "ready"]
        text = f"{len(ready)} of {len(self.skins)} skins publish"
        for one in self.skins:
            if one.state in ("failed", "waiting", "ended"):
                text += f"; {one.settings.name} {one.state}: {one.why}"
        self._supervisor.status(text)
        if not self._reported_ready and not self._ending and all(one.reported for one in self.skins):
            self._reported_ready = True
            self._log.ready(self._folder, ready, len(self.skins))
            self._supervisor.ready()

    def _watch_signals(self, stack: ExitStack) -> None:
        """Have SIGTERM, SIGINT and SIGHUP end the waiting, and ask for the end."""
        woken, waker = socket.socketpair()
        for end in (woken, waker):
            end.setblocking(False)
            stack.callback(end.close)
        stack.callback(signal.set_wakeup_fd, signal.set_wakeup_fd(waker.fileno(), warn_on_full_buffer=False))
        for number in endings():
            stack.callback(signal.signal, number, signal.signal(number, lambda *_: None))

        def heard(_: Any) -> None:
            woken.recv(64)
            self.stop()

        self._selector.register(woken, selectors.EVENT_READ, heard)

    def _end_all(self) -> None:
        """End all processes, whatever happened."""
        for one in self.skins:
            if one.runs:
                one.signal(signal.SIGTERM)
        until_s = time.monotonic() + self._grace_s
        for one in self.skins:
            if one.runs and not one.wait(max(0.0, until_s - time.monotonic())):
                one.signal(signal.SIGKILL)
                one.wait(self._grace_s)

    def _remove_states(self) -> None:
        with suppress(OSError):
            (self._folder / FILE).unlink()
