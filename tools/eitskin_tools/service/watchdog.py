"""Ends a process whose frame loop hangs, so that a supervisor can restart it.

The loop reads from its line, computes, publishes, and reads again. Every read and write is a beat, and while one of
them waits the loop does not hang, however silent the device is. A thread checks four times a second; without a beat in
``limit_s`` of such checks the process logs the reason and what each thread is doing, and ends at once.

It counts checks, not seconds: a process that was stopped (SIGSTOP, a debugger, a suspended machine) or got no core has
made no checks either, and continues.
"""

import faulthandler
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from eitskin.acquisition.transport import Transport, WrappedTransport
from eitskin_tools.processes.periodic_thread import PeriodicThread
from eitskin_tools.service.supervisor import Supervisor

POLL_S: Final = 0.25
"""Between two looks, at most."""

MIN_POLL_S: Final = 0.01

SIGN_S: Final = 1.0
"""Between two signs of life, where the supervisor does not say how often it wants one."""

LIMIT_S: Final = 2.0
"""How long a frame loop may stand still."""

END_S: Final = 5.0
"""How long closing everything may take; it takes some tens of milliseconds."""

LAST_WORDS_S: Final = 1.0
"""Longest time for logging the reason, because the log may have no reader."""

EXIT_STATUS: Final = 70
"""Exit status, which systemd calls SOFTWARE."""


class WatchedLine(WrappedTransport):
    """A transport whose every use is a beat.

    Args:
        line: Open; it stays its owner's to close.
    """

    __slots__ = ("beats", "waits")

    def __init__(self, line: Transport) -> None:
        super().__init__(line)
        self.beats = 0
        self.waits = False
        """A read or write goes on."""

    @property
    def reopen(self) -> Callable[[], None]:
        """Of a line that can be opened anew: what does so."""
        return partial(self._used, getattr(self._line, "reopen"))  # noqa: B009 -- only some have it

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return what has arrived, waiting for the first byte."""
        data: bytes = self._used(self._line.read, timeout_s)
        return data

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""
        self._used(self._line.write, data)

    def _used(self, way: Callable[..., Any], *arguments: Any) -> Any:
        self.waits = True
        try:
            return way(*arguments)
        finally:
            self.beats += 1
            self.waits = False


class Watchdog(PeriodicThread):
    """Looks from when it is entered to when it is left, once it was told at what.

    Args:
        say: Takes the reason, and what each thread is doing.
        supervisor: Gets a sign of life at half of its interval or each second, while there are beats.
        end: Ends the process with an exit status, and does not return.
    """

    def __init__(
        self,
        say: Callable[[str, str], None],
        supervisor: Supervisor,
        end: Callable[[int], object] = os._exit,
    ) -> None:
        self._say, self._supervisor, self._end = say, supervisor, end
        interval_s = supervisor.interval_s
        self._look_s = POLL_S if interval_s is None else min(POLL_S, max(MIN_POLL_S, interval_s / 4.0))
        super().__init__("eitskin-watchdog", self._look_s)
        self._sign_s = SIGN_S if interval_s is None else interval_s / 2.0
        self._since_sign_s = 0.0
        self._what, self._limit_s = "", 0.0
        self._line: WatchedLine | None = None
        self._beats = -1
        self._still_s = 0.0
        self.sockets: list[Path] = []
        """Files to be removed before the process ends."""

    def watch(self, what: str, line: WatchedLine | None = None, limit_s: float = LIMIT_S) -> None:
        """Look, from now on, whether this goes on.

        Args:
            what: Goes on, for people.
            line: Has its beats; None for something that must be done within the limit.
            limit_s: Longest time without a beat.
        """
        self._line, self._still_s, self._what, self._limit_s = line, 0.0, what, limit_s

    def check(self) -> None:
        """Take a look; without a beat for too long, end the process."""
        line = self._line
        if not self._what:
            return
        if line is not None and (line.waits or line.beats != self._beats):
            self._beats, self._still_s = line.beats, 0.0
            self._give_sign()
            return
        self._still_s += self._look_s
        if self._still_s > self._limit_s:
            self._end_all()

    def _give_sign(self) -> None:
        self._since_sign_s += self._look_s
        if self._since_sign_s >= self._sign_s:
            self._since_sign_s = 0.0
            self._supervisor.alive()

    def _end_all(self) -> None:
        """Say why, take the sockets' files away, and end; nothing is waited for that may stand still as well."""
        text = (
            f"{self._what} has stood still for {self._limit_s:g} s; what each thread is doing follows; this ends with "
            f"status {EXIT_STATUS}, so that its supervisor starts it again"
        )
        words = threading.Thread(target=self._say, args=(text, stacks()), daemon=True)
        words.start()
        words.join(LAST_WORDS_S)
        for path in self.sockets:
            with suppress(OSError):
                path.unlink()
        self._end(EXIT_STATUS)


def stacks() -> str:
    """Return what each thread is doing, as :mod:`faulthandler` shows it."""
    descriptor = os.memfd_create("stacks")
    with os.fdopen(descriptor, "r+b") as file:
        faulthandler.dump_traceback(file, all_threads=True)
        file.seek(0)
        return file.read().decode(errors="replace")
