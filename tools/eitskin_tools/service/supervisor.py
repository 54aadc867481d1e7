"""Reports the service's state to systemd: ready, status, alive, stopping (``sd_notify(3)``, ``Type=notify``).

A datagram such as ``READY=1`` goes to the socket that ``NOTIFY_SOCKET`` names; ``@`` stands for the zero byte of an
abstract address. Without a supervisor nothing is sent. A message that the supervisor does not take is dropped, because
a stream must not stop for it.

C code may block Python's interpreter for ever, for example in a library that deadlocks. systemd then misses the signs
of life. A skin of ``eitskin run --config`` has a timer of :mod:`faulthandler` instead, which needs no interpreter: each
sign of life resets it.
"""

import faulthandler
import os
import socket
from collections.abc import Mapping
from contextlib import suppress
from typing import Final, Self

ADDRESS_VARIABLE: Final = "NOTIFY_SOCKET"
INTERVAL_VARIABLE: Final = "WATCHDOG_USEC"
PID_VARIABLE: Final = "WATCHDOG_PID"

HANG_VARIABLE: Final = "EITSKIN_HANG_S"
"""Seconds without a sign of life after which the process shows what each thread is doing, and ends."""


class Supervisor:
    """The supervisor of this process, and the interval of its signs of life.

    Args:
        address: Of a datagram socket: a path, or a name that begins with ``@``; empty for none.
        interval_s: The supervisor ends the process after this time without a sign of life; None for no limit.
        hang_s: The process ends itself after this time without one, even if Python hangs; None for never.
    """

    def __init__(self, address: str = "", interval_s: float | None = None, hang_s: float | None = None) -> None:
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self.interval_s = interval_s if address else None
        self._hang_s = hang_s
        self._socket: socket.socket | None = None
        if address.startswith(("@", "/")):  # others, such as vsock:, are for virtual machines
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Self:
        """Return the supervisor of this process, from systemd's environment variables."""
        interval_s = None
        text, whom = environment.get(INTERVAL_VARIABLE, ""), environment.get(PID_VARIABLE, "")
        if text.isdecimal() and int(text) > 0 and whom in ("", str(os.getpid())):
            interval_s = int(text) * 1e-6
        hang = environment.get(HANG_VARIABLE)
        return cls(environment.get(ADDRESS_VARIABLE, ""), interval_s, None if hang is None else float(hang))

    @property
    def listens(self) -> bool:
        """Whether there is a supervisor."""
        return self._socket is not None

    def ready(self) -> None:
        """Say that the service is up."""
        self._send("READY=1")

    def stopping(self) -> None:
        """Say that the service ends, as it was asked to."""
        self._send("STOPPING=1")

    def alive(self) -> None:
        """Give the sign of life."""
        self._send("WATCHDOG=1")
        if self._hang_s is not None:
            faulthandler.dump_traceback_later(self._hang_s, exit=True)

    def status(self, text: str) -> None:
        """Say in a line how it is."""
        self._send("STATUS=" + " ".join(text.split()))

    def _send(self, line: str) -> None:
        if self._socket is not None:
            with suppress(OSError):
                self._socket.sendto(line.encode(), self._address)

    def close(self) -> None:
        """Tell nothing more; closing twice is fine."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
