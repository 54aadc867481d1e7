"""Tells systemd how the service is: ready, its status, alive, stopping (``sd_notify(3)``, ``Type=notify``).

A datagram such as ``READY=1`` goes to the socket that ``NOTIFY_SOCKET`` names; ``@`` stands for the zero byte of an
abstract address. ``fd:5`` is ours: a socket that was handed down, by which ``eitskin run --config`` hears its skins.
Who was not started by a supervisor tells nobody. A supervisor that does not listen is no reason to stop a stream: what
cannot be sent is left out.
"""

import os
import socket
from collections.abc import Mapping
from contextlib import suppress
from typing import Final, Self

ADDRESS: Final = "NOTIFY_SOCKET"
INTERVAL: Final = "WATCHDOG_USEC"
WHOM: Final = "WATCHDOG_PID"

HANDED_DOWN: Final = "fd:"


class Supervisor:
    """Who started us, and how often a sign of life is wanted.

    Args:
        address: Of a datagram socket: a path, a name that begins with ``@``, or ``fd:`` and the number of one that is
            connected; empty for nobody.
        interval_s: Without a sign of life for so long we are ended; None if none is wanted.
    """

    def __init__(self, address: str = "", interval_s: float | None = None) -> None:
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self.interval_s = interval_s if address else None
        self._socket: socket.socket | None = None
        if address.startswith(("@", "/")):  # others, such as vsock:, are for virtual machines
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        elif address.startswith(HANDED_DOWN):
            self._socket = _taken(address.removeprefix(HANDED_DOWN))

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Self:
        """Return who started us, by what systemd puts into the environment."""
        interval_s = None
        text, whom = environment.get(INTERVAL, ""), environment.get(WHOM, "")
        if text.isdecimal() and int(text) > 0 and whom in ("", str(os.getpid())):
            interval_s = int(text) * 1e-6
        return cls(environment.get(ADDRESS, ""), interval_s)

    @property
    def listens(self) -> bool:
        """Whether anybody is told how it is: who hears by what was handed down wants signs of life alone."""
        return self._socket is not None and not self._address.startswith(HANDED_DOWN)

    def ready(self) -> None:
        """Say that the service is up."""
        self._tell("READY=1")

    def stopping(self) -> None:
        """Say that the service ends, as it was asked to."""
        self._tell("STOPPING=1")

    def alive(self) -> None:
        """Give the sign of life."""
        self._tell("WATCHDOG=1")

    def status(self, text: str) -> None:
        """Say in a line how it is."""
        if self.listens:
            self._tell("STATUS=" + " ".join(text.split()))

    def _tell(self, line: str) -> None:
        if self._socket is not None:
            with suppress(OSError):
                if self._address.startswith(HANDED_DOWN):
                    self._socket.send(line.encode())
                else:
                    self._socket.sendto(line.encode(), self._address)

    def close(self) -> None:
        """Tell nothing more; closing twice is fine."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _taken(number: str) -> socket.socket | None:
    """Return the socket that was handed down, for this process alone; None if there is none."""
    try:
        found = socket.socket(fileno=int(number))
        found.set_inheritable(False)
        found.setblocking(False)
    except (OSError, ValueError, OverflowError):
        return None
    return found
