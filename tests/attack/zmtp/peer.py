"""A ZMTP 3.0 client over ipc and TCP, mechanism NULL, that may say anything at any time: no libzmq, nothing of eitskin.

Written from RFC 23 (ZMTP 3.0) alone. ::

    greeting   FF 00*8 7F | 3 0 | "NULL" 00*16 | as-server 0 | 00*31         64 bytes, each way
    command    04 size(1) | 06 size(8), then name size(1) name data
    message    00 size(1) | 02 size(8), then the body; 01 and 03 where more parts follow
"""

import socket
import struct
import time
from typing import Final

GREETING: Final = b"\xff" + bytes(8) + b"\x7f" + bytes([3, 0]) + b"NULL".ljust(20, b"\0") + bytes(32)
LONG: Final = 2
COMMAND: Final = 4


def packed(body: bytes, flags: int = 0) -> bytes:
    """Return a frame of ZMTP."""
    if len(body) > 255:
        return struct.pack(">BQ", flags | LONG, len(body)) + body
    return bytes([flags, len(body)]) + body


def ready(kind: str) -> bytes:
    """Return the command that ends the handshake."""
    return packed(b"\x05READY\x0bSocket-Type" + struct.pack(">I", len(kind)) + kind.encode(), COMMAND)


def connected(endpoint: str, patience_s: float = 10.0) -> socket.socket:
    """Return a stream to an endpoint that says nothing yet; asks again while nobody is there, or too many wait.

    Raises:
        OSError: It could not be had in time.
    """
    end_s = time.monotonic() + patience_s
    while True:
        stream = attempt(endpoint)
        if stream is not None:
            return stream
        if time.monotonic() > end_s:
            raise OSError(f"no connection to {endpoint} within {patience_s} s")
        time.sleep(0.01)


def attempt(endpoint: str) -> socket.socket | None:
    """Return a non-blocking stream to an endpoint, or None if it cannot be had at once."""
    scheme, _, rest = endpoint.partition("://")
    local = scheme == "ipc"
    stream = socket.socket(socket.AF_UNIX if local else socket.AF_INET)
    stream.settimeout(0.0 if local else 0.2)  # TCP on loopback is answered by the kernel, if its queue is not full
    host, _, port = rest.rpartition(":")
    try:
        stream.connect(rest if local else (host, int(port)))
    except OSError:
        stream.close()
        return None
    stream.setblocking(False)
    return stream


class Peer:
    """One connection, greeted and let in.

    Args:
        endpoint: ``ipc:///path`` or ``tcp://address:port``.
        kind: What it says that it is, such as SUB or REQ.
        patience_s: How long anything may take.

    Raises:
        OSError: It is not let in, or the other side is no ZMTP NULL.
    """

    def __init__(self, endpoint: str, kind: str = "SUB", patience_s: float = 10.0) -> None:
        self.stream = connected(endpoint, patience_s)
        self.stream.settimeout(patience_s)
        self._buffer = bytearray()
        try:
            self.stream.sendall(GREETING + ready(kind))
            self._greet()
        except BaseException:
            self.stream.close()
            raise

    def _greet(self) -> None:
        """Wait until the other side is ready: who sends messages before is ended where it asks who may enter."""
        greeted = len(GREETING)
        while len(self._buffer) < greeted + 2 or len(self._buffer) < greeted + 2 + self._buffer[greeted + 1]:
            self._more()
        if self._buffer[10] < 3 or self._buffer[12:16] != b"NULL" or self._buffer[greeted + 2 :][:6] != b"\x05READY":
            raise OSError(f"no ZMTP 3 with NULL, but {bytes(self._buffer[:80])!r}")
        del self._buffer[: greeted + 2 + self._buffer[greeted + 1]]

    def _more(self) -> None:
        data = self.stream.recv(1 << 18)
        if not data:
            raise ConnectionResetError("the other side left")
        self._buffer += data

    def subscribe(self, *topics: bytes) -> None:
        """Subscribe as ZMTP 3.0 does, by messages."""
        self.stream.sendall(b"".join(packed(b"\x01" + topic) for topic in topics))

    def close(self) -> None:
        """Leave."""
        self.stream.close()
