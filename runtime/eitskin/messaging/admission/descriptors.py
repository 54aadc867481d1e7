"""Open files: how many there are, how many there may be, and which of them are connections.

libzmq 4.3.5 aborts the whole process when its ipc listener finds no descriptor for a connection (``ipc_listener.cpp``;
a tcp listener survives). So whoever lets somebody in asks here first, and one at a time in the whole process.
"""

import fcntl
import os
import resource
import select
import socket
import stat
import struct
import termios
from typing import Final

RESERVE: Final = 12
"""Descriptors that stay free for whatever the process opens itself: a port that comes back, a file."""

MANY: Final = 65536
"""What counts as no limit."""

MOST_CAME: Final = 64 * 2**20
"""Bytes that may wait at one connection: more than Linux keeps for any, unless its owner raised that."""

_NOWHERE: Final = bytearray(2**17)
"""Where what nobody wants is read to."""

Connection = tuple[int, int]
"""A connection as long as it lives: its descriptor and its inode. A number that is used again has another inode."""


def connection_at(descriptor: int) -> Connection | None:
    """Return which socket lies at a descriptor now; None if there is none."""
    try:
        found = os.fstat(descriptor)
    except OSError:
        return None
    return (descriptor, found.st_ino) if stat.S_ISSOCK(found.st_mode) else None


def end(connection: Connection) -> None:
    """End a connection, if it still lives: libzmq finds it ended by the other side and cleans up.

    What came from it and was not read yet is thrown away: libzmq would still read all of it, megabytes of a flood over
    TCP. It is not reset: who sends without end, and finds the window shut, may wait a minute for it to open, and cannot
    come again at once.
    """
    try:
        copy = socket.socket(fileno=os.dup(connection[0]))
    except OSError:
        return
    with copy:
        if os.fstat(copy.fileno()).st_ino == connection[1]:  # of the copy: what lies there may change at any time
            try:
                copy.shutdown(socket.SHUT_RDWR)
                _throw_away(copy)
            except OSError:
                return  # the other side was faster, or nothing is left


def _throw_away(ended: socket.socket) -> None:
    """Read what came by a connection from which no more can come; raises OSError once nothing is left."""
    for _ in range(MOST_CAME // len(_NOWHERE)):
        if not ended.recv_into(_NOWHERE, 0, socket.MSG_DONTWAIT | socket.MSG_TRUNC):  # TCP does not even copy it
            return


def limit() -> int:
    """Return how many files may be open."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MANY if soft == resource.RLIM_INFINITY else min(soft, MANY)


def open_files() -> list[int]:
    """Return the open descriptors; one more may be among them that was needed to look."""
    try:
        return [int(name) for name in os.listdir("/proc/self/fd")]
    except OSError:  # not even that one is left
        return [number for number in range(limit()) if _is_open(number)]


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True


def room(used: int | None = None) -> int:
    """Return how many files may still be opened for others; less than nothing if the reserve is used.

    Args:
        used: How many are open, if that was just counted.
    """
    return limit() - (len(open_files()) if used is None else used) - RESERVE


def unread(descriptor: int) -> int:
    """Return how many bytes wait at a descriptor; 0 where that cannot be said."""
    try:
        answer = fcntl.ioctl(descriptor, termios.FIONREAD, bytes(4))
    except OSError:
        return 0
    return int(struct.unpack("=i", answer)[0])


def somebody_waits(listener: int) -> bool:
    """Return whether a connection to a listening socket waits to be accepted."""
    poll = select.poll()
    poll.register(listener, select.POLLIN)
    return any(event & select.POLLIN for _, event in poll.poll(0))
