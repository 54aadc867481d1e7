"""Descriptors that libzmq will take soon: nobody else is promised any before it has, and no TCP address takes them."""

import threading
from typing import Final

from eitskin.messaging.admission.descriptors import Connection, connection_at, limit, room, somebody_waits
from eitskin.messaging.admission.shutter import Shutter

PLENTY: Final = 4096
"""With so many descriptors left no TCP address needs to be shut: of each, 640 connections are held at most."""

MEANWHILE: Final = 64
"""Connections that a TCP address may take in meanwhile if it cannot be shut; a quarter of few descriptors."""


class Promises:
    """One object for the whole process, whose sockets all draw on the same files."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: set[Connection | None] = set()
        """From which libzmq accepts."""
        self._strangers: list[Shutter] = []
        """Of the TCP addresses, where libzmq accepts without asking."""
        self._shut = False

    def give(self, listener: int, connections: int) -> bool:
        """Promise descriptors to a listener's connections; False if there is no room, or another is served now."""
        with self._lock:
            self._tidy()
            if self._listeners:
                return False
            if not self._strangers or room() >= connections + PLENTY:
                taken_meanwhile = 0
            else:
                self._shut = True
                others = min(MEANWHILE, limit() // 4)
                taken_meanwhile = sum(one.most if one.shut() else others for one in self._strangers)
            if room() < connections + taken_meanwhile:  # counted once nobody else comes
                self._open()
                return False
            self._listeners.add(connection_at(listener))
            return True

    def _tidy(self) -> None:
        """Forget listeners from which libzmq has accepted everybody."""
        self._listeners = {
            other
            for other in self._listeners
            if other is not None and connection_at(other[0]) == other and somebody_waits(other[0])
        }

    def settle(self) -> None:
        """Open what was shut, if what was promised is taken: to be called every so often by who has a TCP address."""
        if self._shut:
            with self._lock:
                self._tidy()
                if not self._listeners:
                    self._open()

    def _open(self) -> None:
        for one in self._strangers:
            one.open()
        self._shut = False

    def stranger_came(self, shutter: Shutter) -> None:
        """Take note of a TCP address, where libzmq accepts without asking."""
        with self._lock:
            self._strangers.append(shutter)

    def stranger_left(self, shutter: Shutter) -> None:
        """Take note that it is closed."""
        with self._lock:
            self._strangers.remove(shutter)
            shutter.close()

    def withdraw(self, listener: int) -> None:
        """Take note that a listener is closed."""
        with self._lock:
            self._listeners.discard(connection_at(listener))


PROMISES: Final = Promises()
