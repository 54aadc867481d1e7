"""Whether the process of a skin still lives, as the supervising process sees it.

What within a process looks after its frame loop needs the interpreter, which C code may keep for ever. So the process
gives signs of life, as it gives them to systemd: only while its frame loop reads, computes and reads again, or waits
for its line, and only from Python. They come over a pair of sockets that nobody else can reach.
"""

import signal
import socket
from typing import Final

from eitskin_tools.processes.own_time import OwnTime

SILENT_S: Final = 5.0
"""How long a skin that is ready may give no sign of life. Its own watchdog ends it after 2 s, takes 1 s at most to say
why, and the last sign is up to 1 s old when the loop stops: so the process speaks first wherever it can."""

OVERDUE: Final = 0.4
"""Part of it after which a sign is overdue, and from when the process' own time is counted."""

ENDING_S: Final = 8.0
"""The same of one that has said that it ends: it ends itself after 5 s, whatever hangs."""

LOOKS: Final = 10
"""Looks in the longest silence."""

PAUSE_S: Final = 1.0
"""Between a signal and the next, stronger one."""

FORCE: Final = (signal.SIGTERM, signal.SIGABRT, signal.SIGKILL)
"""By the second one Python shows what each thread is doing, without the interpreter's lock, and the process ends."""

LARGEST: Final = 4096


class Life:
    """The signs of life of one process.

    Args:
        ear: Where they are heard.
        pid: Whose they are.
        silent_s: Longest time without one, once it is ready.
    """

    def __init__(self, ear: socket.socket, pid: int, silent_s: float = SILENT_S) -> None:
        ear.setblocking(False)
        self.ear, self._pid, self._silent_s = ear, pid, silent_s
        self.due_s: float | None = None
        """When to look; None before it is ready: starting takes as long as it takes."""
        self.forced = False
        """Whether it was told to end because it gave no sign."""
        self._limit_s = silent_s
        self._silence_s = 0.0
        self._own: OwnTime | None = None
        self._tried = 0

    def hear(self, now_s: float) -> None:
        """Take what has come."""
        while True:
            try:
                lines = self.ear.recv(LARGEST).split(b"\n")
            except OSError:  # nothing more, for now or for good
                return
            if b"READY=1" in lines or b"STOPPING=1" in lines or (b"WATCHDOG=1" in lines and self.due_s is not None):
                if b"STOPPING=1" in lines:
                    self._limit_s = max(self._limit_s, ENDING_S)
                self._own, self._tried, self.due_s = None, 0, now_s + OVERDUE * self._limit_s

    def look(self, now_s: float) -> signal.Signals | None:
        """Look, when it is due, whether it has been silent for too long.

        Returns:
            What to send it now: what is stronger each time.
        """
        if self.due_s is None or now_s < self.due_s:
            return None
        if self._tried:
            return self._next(now_s)
        every_s = self._limit_s / LOOKS
        self.due_s = now_s + every_s
        if self._own is None:
            self._own, self._silence_s = OwnTime(self._pid, now_s), OVERDUE * self._limit_s
            return None
        self._silence_s += min(self._own.since_last(now_s), 2 * every_s)  # whoever looks may have been stopped as well
        return self._next(now_s) if self._silence_s > self._limit_s else None

    def _next(self, now_s: float) -> signal.Signals:
        number = FORCE[min(self._tried, len(FORCE) - 1)]
        self._tried, self.forced, self.due_s = self._tried + 1, True, now_s + PAUSE_S
        return number

    @property
    def why(self) -> str:
        """For people: why it is ended."""
        what = "its frame loop" if self._limit_s == self._silent_s else "its end"
        return f"no sign of life for {self._limit_s:g} s: {what} stands still, and nothing in the process can say so"

    def close(self) -> None:
        """Hear no more."""
        self.ear.close()
