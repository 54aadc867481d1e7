"""An ipc address that libzmq never accepts on while somebody may come: it is given closed batches of newcomers.

A listening socket of our own lies at the path. If somebody waits there and there is room, another one takes its place,
and the first one goes to libzmq: nobody reaches it any more, so libzmq accepts those who wait, and never more than its
queue holds. However fast a flood is, and however long nobody looks, no more descriptors are taken than were counted. ::

    path -> L1    A, B wait
    path -> L2    L1 goes to libzmq, which accepts A and B        L2 is renamed onto the path: no gap for C
    path -> L2    C waits

libzmq ends a listener's connections with it, so each is kept until all of its own have left.
"""

import errno
import itertools
import os
import socket
import stat
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import zmq

from eitskin.messaging.admission.connections import Name
from eitskin.messaging.admission.descriptors import room, somebody_waits
from eitskin.messaging.admission.promises import PROMISES

BATCH: Final = 8
"""Newcomers that are let in at once, at most; 128 that come together are in after 16 looks."""

SHARE: Final = 6
"""A batch takes at most one part in so many of the descriptors that are left."""

_NUMBERS: Final = itertools.count()
"""Of listeners in this process, whose names must differ."""


@dataclass(frozen=True, slots=True)
class _Batch:
    """A listener in libzmq's hands."""

    descriptor: int
    endpoint: str
    """As libzmq calls it."""


class Gate:
    """Listens at a path for a ZeroMQ socket; leave it with ``close``, before the socket is closed.

    Args:
        socket_: Of zmq, not bound.
        path: Where; nothing is there.
        most: How many are served at once.

    Raises:
        OSError: The path cannot be bound.
    """

    __slots__ = ("_batches", "_empty", "_listener", "_mine", "_path", "_socket", "size")

    def __init__(self, socket_: Any, path: Path, most: int) -> None:
        self._socket, self._path = socket_, path
        self._batches: dict[str, _Batch] = {}
        """By the path at which the listener was bound."""
        self._empty: set[str] = set()
        """Of those, which looked empty at the last look."""
        self.size = 1
        """How many may wait at the path."""
        self._listener = self._listen(most, first=True)

    def _listen(self, most: int, *, first: bool = False) -> socket.socket:
        """Return a new listener that lies at the path, in nobody's reach but its owner's, where so many may wait."""
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
        try:
            os.fchmod(listener.fileno(), 0o600)  # before it is bound: its file has this mode from the first instant
            name = self._bind(listener)
            try:
                self.size = max(1, min(most, BATCH, room() // SHARE))
                listener.listen(self.size - 1)  # Linux lets one more wait
                if first:
                    os.link(name, self._path)  # not over one that somebody else bound just now
                else:
                    name.rename(self._path)
            finally:
                name.unlink(missing_ok=True)
        except BaseException:
            listener.close()
            raise
        self._mine = self._path.lstat().st_ino
        return listener

    def _bind(self, listener: socket.socket) -> Path:
        """Bind a listener beside the path, and return where."""
        while True:
            name = self._path.with_name(f".{next(_NUMBERS) % 0x100000:x}")
            try:
                listener.bind(os.fspath(name))
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise
            else:
                return name

    @property
    def descriptor(self) -> int:
        """To wait on."""
        return self._listener.fileno()

    def ours(self, name: Name) -> bool:
        """Whether a connection's own end is called like one of the listeners."""
        return name in self._batches

    def let_in(self, places: int) -> bool:
        """Let in who waits, if there are descriptors for them and for a new listener.

        Args:
            places: How many may come in all, now and next.
        """
        descriptor = self.descriptor
        if not PROMISES.give(descriptor, self.size + 1):
            return False
        waiting, size = self._listener, self.size
        try:
            self._listener = self._listen(places - size)
        except OSError:  # the folder is gone, and everybody's way here with it
            self.size = size
            PROMISES.withdraw(descriptor)
            return False
        bound = waiting.getsockname()
        try:
            self._socket.setsockopt(zmq.USE_FD, descriptor)
            self._socket.bind(f"ipc://{bound}")
        except zmq.ZMQError:  # the context ends
            PROMISES.withdraw(descriptor)
            waiting.close()
            raise
        waiting.detach()
        self._socket.setsockopt(zmq.USE_FD, -1)
        endpoint = str(self._socket.getsockopt_string(zmq.LAST_ENDPOINT)).rstrip("\0")
        self._batches[bound] = _Batch(descriptor, endpoint)
        return True

    def forget(self, names: Iterable[str]) -> None:
        """Give listeners back whose connections have all left.

        One that looks empty for the first time is kept: whoever is being accepted just now waits no more, and has no
        descriptor yet.

        Args:
            names: Of those that nobody waits at and nobody came through who is still here.
        """
        empty = set(names)
        gone, self._empty = empty & self._empty, empty - self._empty
        for name in gone:
            batch = self._batches.pop(name)
            PROMISES.withdraw(batch.descriptor)
            with suppress(zmq.ZMQError):
                self._socket.unbind(batch.endpoint)

    @property
    def settled(self) -> set[str]:
        """Names of the listeners from which libzmq has accepted everybody."""
        return {name for name, batch in self._batches.items() if not somebody_waits(batch.descriptor)}

    def close(self) -> None:
        """Let nobody in any more, and take the file away if it is still ours."""
        with suppress(OSError):
            found = self._path.lstat()
            if stat.S_ISSOCK(found.st_mode) and found.st_ino == self._mine:
                self._path.unlink()
        self._listener.close()
        for batch in self._batches.values():
            PROMISES.withdraw(batch.descriptor)
