"""What a TCP connection has sent, by the kernel's count: libzmq bounds the parts of a message, but not their number.

What was taken out of the socket as whole messages may be taken off; the rest lies in libzmq's memory. An ipc connection
is not counted, the kernel keeps no sum there; only the runtime's own user and root can make one.
"""

import os
import socket
import struct
import time
from collections import deque
from collections.abc import Collection
from typing import Final

from eitskin.messaging.admission.descriptors import Connection, unread

ALLOWANCE: Final = 65536
"""Bytes of a subscriber that may come at once; it sends a few hundred when it comes, with CURVE a kilobyte."""

OVERHEAD: Final = 64
"""Bytes of a part on the wire beside its own: ZMTP has up to 9, CURVE 34 more."""

MODEST: Final = 2048
"""Bytes that who is honest has sent when it has come and asked for all that it wants, also with CURVE."""

PER_S: Final = 8192.0
"""Bytes a second that may come for ever: a region declared anew a hundred times a second."""

AT_A_TIME: Final = 16
"""Connections that are looked at in one look, in turn, so that a look stays short."""

_RECEIVED: Final = struct.Struct("=Q")
_RECEIVED_AT: Final = 128
"""Where tcpi_bytes_received lies in Linux's ``struct tcp_info``."""


class Traffic:
    """Bytes of connections, as a bucket that leaks.

    Args:
        allowance: Bytes above which it is too much.
    """

    __slots__ = ("_allowance", "_levels", "_turn")

    def __init__(self, allowance: int) -> None:
        self._allowance = allowance
        self._levels: dict[Connection, tuple[int, float, float]] = {}
        """Bytes so far, level of the bucket, and when."""
        self._turn: deque[Connection] = deque()

    def greedy(self, connections: Collection[Connection]) -> list[Connection]:
        """Return who has sent too much, of the next ``AT_A_TIME``.

        Args:
            connections: All that come by TCP.
        """
        if not self._turn:
            self._turn.extend(connections)
            self._levels = {one: level for one, level in self._levels.items() if one in connections}
        now_s = time.monotonic()
        return [
            one
            for one in (self._turn.popleft() for _ in range(min(AT_A_TIME, len(self._turn))))
            if self._rise(one, now_s) > self._allowance
        ]

    def took(self, one: Connection, size: int, parts: int) -> None:
        """Take note that a whole message was taken, so many bytes in so many parts: it lies nowhere any more."""
        received, level, then_s = self._levels.get(one, (0, 0.0, time.monotonic()))
        self._levels[one] = (received, level - size - OVERHEAD * parts, then_s)

    def _rise(self, one: Connection, now_s: float) -> float:
        received = received_from(one) - unread(one[0])
        before, level, then_s = self._levels.get(one, (0, 0.0, now_s))
        leaked = min(max(0.0, level), PER_S * (now_s - then_s))
        level = max(level - leaked + received - before, -self._allowance)
        self._levels[one] = (received, level, now_s)
        return level


def received_from(connection: Connection) -> int:
    """Return how many bytes have come in all; 0 if the connection is gone."""
    try:
        if os.fstat(connection[0]).st_ino != connection[1]:
            return 0
        looked_through = socket.socket(socket.AF_INET, socket.SOCK_STREAM, 0, fileno=connection[0])
    except OSError:
        return 0
    try:
        info = looked_through.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _RECEIVED_AT + _RECEIVED.size)
    except OSError:
        return 0
    finally:
        looked_through.detach()
    return int(_RECEIVED.unpack_from(info, _RECEIVED_AT)[0]) if len(info) >= _RECEIVED_AT + _RECEIVED.size else 0
