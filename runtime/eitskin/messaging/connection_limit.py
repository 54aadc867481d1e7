"""How many connections a ZeroMQ socket holds, so that a flood can be cut off before the process runs out of files.

libzmq 4.3.5 aborts the whole process when an ipc listener gets EMFILE (``ipc_listener.cpp``; a tcp listener survives).
Whoever may connect could therefore end the runtime. A monitor tells of every connection made and ended; the socket's
owner closes and reopens it when there are too many.
"""

import struct
from contextlib import suppress
from typing import Any, Final

import zmq

EVENT: Final = struct.Struct("=H")
"""How a message of a socket's monitor begins. (pyzmq's own reader would import asyncio: 30 ms, 8 MB.)"""


_POLLIN: Final = int(zmq.POLLIN)


class Connections:
    """Counts one socket's connections; release it with ``close`` before the socket.

    Args:
        socket: Of zmq, not yet bound.
    """

    __slots__ = ("_socket", "monitor", "open")

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self.monitor: Any = socket.get_monitor_socket(zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED)
        """To wait on."""
        self.open = 0
        """Connections as of the last ``look``."""

    def look(self) -> int:
        """Return how many connections there are; never waits."""
        while self.monitor.getsockopt(zmq.EVENTS) & _POLLIN:
            (event,) = EVENT.unpack_from(self.monitor.recv_multipart(zmq.NOBLOCK)[0])
            self.open += 1 if event == zmq.EVENT_ACCEPTED else -1
        return self.open

    def close(self) -> None:
        """Stop counting."""
        with suppress(zmq.ZMQError):
            self._socket.disable_monitor()
        self.monitor.close(0)
