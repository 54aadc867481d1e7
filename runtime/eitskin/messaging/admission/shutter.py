"""A TCP address that can be shut for a moment: whoever knocks then is not heard, and knocks again a second later.

libzmq accepts on TCP whoever comes, at any time, from a thread of its own. While it accepts from an ipc listener, where
it aborts if there is no descriptor left, nobody else may take any. A filter on the listening socket has the kernel drop
what comes to it; connections that there are already are not touched. What has come before still waits to be accepted,
but that is no more than the socket's queue holds.
"""

import ctypes
import socket
import struct
from typing import Final

from eitskin.messaging.admission.descriptors import limit, open_files

LONGEST_QUEUE: Final = 100
"""What libzmq lets wait at a listening socket, unless it is told otherwise."""

SHARE: Final = 16
"""A queue holds at most one part in so many of the files that may be open."""

ATTACH_FILTER: Final = getattr(socket, "SO_ATTACH_FILTER", 26)

DETACH_FILTER: Final = getattr(socket, "SO_DETACH_FILTER", 27)

_NOTHING: Final = ctypes.create_string_buffer(struct.pack("=HBBI", 0x06, 0, 0, 0), 8)
"""A program of one instruction (linux/filter.h): return 0, which keeps no byte of any packet."""


def queue() -> int:
    """Return how many may wait to be accepted, as ``listen`` takes it."""
    return max(1, min(LONGEST_QUEUE, limit() // SHARE))


class Shutter:
    """At the listening socket of a port of this process; leave it with ``close``, before that socket is closed.

    Args:
        port: Which libzmq listens at.
    """

    def __init__(self, port: int) -> None:
        self._listener = _listener(port)
        self._shut = False
        self.most = queue() + 2
        """Connections that are still accepted once it is shut: Linux lets one more wait, and one is on its way in."""

    def shut(self) -> bool:
        """Let nobody knock; return whether that was possible."""
        if self._listener is not None and not self._shut:
            program = struct.pack("@HP", 1, ctypes.addressof(_NOTHING))
            try:
                self._listener.setsockopt(socket.SOL_SOCKET, ATTACH_FILTER, program)
            except OSError:  # a kernel without filters
                return False
            self._shut = True
        return self._shut

    def open(self) -> None:
        """Let everybody knock again."""
        if self._listener is not None and self._shut:
            self._listener.setsockopt(socket.SOL_SOCKET, DETACH_FILTER, 0)
            self._shut = False

    def close(self) -> None:
        """Let go of the socket; closing twice is fine."""
        if self._listener is not None:
            self._listener.close()
            self._listener = None


def _listener(port: int) -> socket.socket | None:
    """Return the socket of this process that listens at a port, once more."""
    for number in open_files():
        try:
            looked_through = socket.socket(fileno=number)
        except OSError:  # it is no socket
            continue
        try:
            ours = (
                looked_through.family in (socket.AF_INET, socket.AF_INET6)
                and looked_through.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
                and looked_through.getsockname()[1] == port
            )
            if ours:
                return looked_through.dup()
        except OSError:
            continue
        finally:
            looked_through.detach()
    return None
