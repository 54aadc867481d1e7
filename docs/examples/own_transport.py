"""Your own transport: a skin behind a serial-to-network adapter, read through a TCP socket.

    python docs/examples/own_transport.py HOST PORT

Pass an object with these methods and properties in place of a port's name; it needs no base class
(:class:`eitskin.Transport`).
"""

import os
import select
import socket
import sys
from contextlib import suppress

import eitskin


class SocketLine:
    """A full-duplex byte stream that blocks in ``read`` and can be woken from elsewhere.

    Args:
        host: The adapter's address.
        port: The adapter's TCP port.
    """

    line_bytes_per_s = 0  # no baud rate limits it

    def __init__(self, host: str, port: int) -> None:
        self.name = f"{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout=5.0)
        except OSError as error:
            raise eitskin.PortMissing(f"{self.name} cannot be reached: {error}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK)

    def read(self, timeout_s: float | None = None) -> bytes:
        """Wait for the first byte and return all that have arrived; none after the timeout or ``cancel``."""
        ready, _, _ = select.select([self._socket, self._wake], [], [], timeout_s)
        if self._wake in ready:
            os.eventfd_read(self._wake)
            return b""
        if not ready:
            return b""
        try:
            data = self._socket.recv(65536)
        except OSError as error:
            raise eitskin.PortLost(f"{self.name} is gone: {error}") from error
        if not data:
            raise eitskin.PortLost(f"{self.name} hung up")
        return data

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise eitskin.PortLost(f"{self.name} is gone: {error}") from error

    def cancel(self) -> None:
        """Make the current ``read``, or else the next one, return at once."""
        os.eventfd_write(self._wake, 1)

    def report(self) -> list[str]:
        """Return lines for people that describe the line's settings."""
        return [f"{self.name}: TCP, without delay"]

    def close(self) -> None:
        """Close the line; a second call does nothing."""
        self._socket.close()
        with suppress(OSError):
            os.close(self._wake)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    with suppress(KeyboardInterrupt), eitskin.Skin(SocketLine(sys.argv[1], int(sys.argv[2]))) as skin:
        skin.capture_reference(frames=50)
        for frame in skin.frames(timeout_s=2.0):
            print(f"frame {frame.sequence} over TCP: highest pixel {frame.map.max():.2f}")
