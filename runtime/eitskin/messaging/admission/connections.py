"""The connections of one bound socket, found among the process's own descriptors; libzmq is not asked.

A monitor of libzmq tells of connections too, but its I/O thread waits for whoever does not read, and whoever ends the
monitor waits for the I/O thread: a flood of connections and a process that does something else for a moment never end.
"""

import select
import socket
import time
from collections.abc import Callable, Container, Iterable
from typing import Final

from eitskin.messaging.admission.descriptors import Connection, connection_at, end, limit, open_files, room, unread
from eitskin.messaging.admission.traffic import ALLOWANCE, Traffic

GRACE_S: Final = 0.5
"""How long a newcomer has to say what it wants before it must make room for others."""

SPARE: Final = 16
"""Newcomers that have not said anything yet, beside as many as are served."""

MANY_SPARE: Final = 512
"""Newcomers beyond which none is given time."""

MOST_UNREAD: Final = 8192
"""Bytes of one connection that wait to be read. Whoever is honest sends a few hundred in all; a flood fills its line,
and libzmq would go on reading it."""

AHEAD: Final = 64
"""Descriptors beyond the last one that was seen, among which newcomers are looked for."""

Name = str | int
"""What a connection's own end is called: the path of its listener, or the port."""


class Connections:
    """Whom a socket talks to.

    Args:
        most: How many are served at once.
        ours: Whether a name is that of one of the socket's listeners.
        allowance_bytes: See :class:`~.traffic.Traffic`.
    """

    __slots__ = ("_all", "_most", "_ours", "_poll", "_polled", "_traffic", "ended", "greedy", "room")

    def __init__(self, most: int, ours: Callable[[Name], bool], allowance_bytes: int = ALLOWANCE) -> None:
        self._most, self._ours = most, ours
        self._all: dict[Connection, tuple[Name | None, float]] = {}
        """Name and when it was seen first, of every socket of the process, in that order; None for what is not ours."""
        self.ended = 0
        """Connections that were ended because there were too many."""
        self.greedy = 0
        """Connections that were ended because they sent more than anybody honest would."""
        self._poll = select.poll()
        self._polled = 0
        """Descriptors below this one are looked at for what waits to be read."""
        self._traffic = Traffic(allowance_bytes)
        self.room = 0
        """Descriptors that were left for others at the last ``look``; see :func:`~.descriptors.room`."""

    def look(self) -> dict[Connection, Name]:
        """Return all connections and where they came in, the oldest first."""
        now_s = time.monotonic()
        numbers = open_files()
        self.room = room(len(numbers))
        self._watch(min(max(numbers, default=0) + AHEAD, limit()))  # the kernel refuses to look at more
        here = {found for number in numbers if (found := connection_at(number)) is not None}
        kept = {found: what for found, what in self._all.items() if found in here}
        fresh = sorted(here - kept.keys(), key=lambda found: found[1])
        self._all = kept | {found: (self._name(found), now_s) for found in fresh}
        return {found: name for found, (name, _) in self._all.items() if name is not None}

    def _watch(self, upto: int) -> None:
        for number in range(self._polled, upto):
            self._poll.register(number, select.POLLIN)
        self._polled = max(self._polled, upto)

    def end_greedy(self) -> None:
        """End who sends without end; one system call while nobody sends, and a few for each TCP connection in turn."""
        for number, event in self._poll.poll(0):
            if event & select.POLLIN and unread(number) > MOST_UNREAD:
                connection = self.at(number)
                if connection is not None:
                    self._end_one(connection)
        self.end_endless()

    def end_endless(self) -> None:
        """End who sends messages without end by TCP; of ipc only the lines are looked at, by ``end_greedy``."""
        for connection in self._traffic.greedy([one for one, (name, _) in self._all.items() if isinstance(name, int)]):
            self._end_one(connection)

    def took(self, connection: Connection, size: int, parts: int) -> None:
        """Take note of a whole message of a connection that was taken out of the socket."""
        self._traffic.took(connection, size, parts)

    def _end_one(self, connection: Connection) -> None:
        end(connection)
        self.greedy += 1

    def at(self, descriptor: int) -> Connection | None:
        """Return which of the connections lies at a descriptor now; None if it is none of them."""
        found = connection_at(descriptor)
        if found is None:
            return None
        if found not in self._all:
            self._all[found] = (self._name(found), time.monotonic())
        return found if self._all[found][0] is not None else None

    def _name(self, connection: Connection) -> Name | None:
        name = _own_name(connection)
        return name if name is not None and self._ours(name) else None

    def cull(self, living: Iterable[Connection], keep: Container[Connection], expected: int = 0) -> int:
        """End who is too many, and return how many more there is a place for.

        Those that asked for nothing make room first, the oldest before all: whoever is honest asks at once. Of those in
        ``keep`` only such go as came when there were enough already.

        Args:
            living: All connections, as :meth:`look` just gave them.
            keep: Connections that are served.
            expected: How many more are about to come.
        """
        now_s = time.monotonic()
        served, silent = list[Connection](), list[Connection]()
        for one in living:
            (served if one in keep else silent).append(one)
        present = len(served) + len(silent)
        places = min(self._most + SPARE, present + self.room // 2)
        wanted = max(0, present + expected - places)
        forced = max(len(silent) - MANY_SPARE, -self.room)  # it cannot wait: there are too many, or no descriptors
        idle = [
            one
            for index, one in enumerate(silent[: max(wanted, forced, 0)])
            if index < forced or now_s - self._all[one][1] > GRACE_S
        ]
        surplus = served[min(self._most, len(served) - max(0, -self.room - len(idle))) :]
        for one in (*idle, *surplus):
            end(one)
        self.ended += len(idle) + len(surplus)
        return min(places - present, self._most - len(served)) if len(served) < self._most else 0


def _own_name(connection: Connection) -> Name | None:
    """Return what a connected socket's own end is called; None for a listener, or one that is gone.

    Needs no descriptor: where none is left, a connection whose name could not be had would never be served.
    """
    try:
        looked_through = socket.socket(fileno=connection[0])
    except OSError:
        return None
    try:
        family, kind = looked_through.family, looked_through.type
        listens = looked_through.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
        name = looked_through.getsockname()
    except OSError:
        return None
    finally:
        looked_through.detach()
    if connection_at(connection[0]) != connection or kind != socket.SOCK_STREAM or listens:
        return None  # inodes do not come back: what lies there now lay there all the while
    if family == socket.AF_UNIX:
        return name if isinstance(name, str) and name else None
    return int(name[1]) if family in (socket.AF_INET, socket.AF_INET6) else None
