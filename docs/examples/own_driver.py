"""Your own electronics: a driver for a device that sends 208 voltages a line to a TCP socket.

    python docs/examples/own_driver.py HOST:PORT

The sheet must be flat and untouched when the program starts. A package that registers ``NetworkDevice`` under the
entry-point group ``eitskin.devices`` as ``network`` gives every command the port ``network:HOST:PORT``.
"""

import socket
import sys
from collections.abc import Iterator
from contextlib import suppress

import numpy as np

import eitskin
from eitskin.acquisition.drivers.driver import Scan
from eitskin_proto.sensor.row_table import named


class NetworkDevice:
    """A device that sends a scan a line.

    Args:
        address: HOST:PORT.
    """

    name, settings = "network", {"current_A": 1e-3}
    table, signed = named("adjacent-208"), True
    rate_hz, step_V, full_scale_V = 50.0, 1e-6, 2.5

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        self.serial_number = address[-16:]
        self._socket = socket.create_connection((host, int(port)), timeout=5.0)
        self._socket.setblocking(False)
        self._begun = b""

    def fileno(self) -> int:
        """Return what becomes readable when a scan arrives."""
        return self._socket.fileno()

    def scans(self) -> Iterator[Scan]:
        """Yield the scans that have arrived, without waiting."""
        try:
            data = self._socket.recv(65536)
        except BlockingIOError:
            return
        if not data:
            raise eitskin.PortLost(f"{self.serial_number} hung up")
        *lines, self._begun = (self._begun + data).split(b"\n")
        for line in lines:
            yield Scan(np.array(line.split(), dtype=np.float64))

    def start(self) -> None:
        """Do nothing: the device sends by itself."""

    def stop(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    with suppress(KeyboardInterrupt), eitskin.Skin(source=NetworkDevice(sys.argv[1])) as skin:
        skin.capture_reference(frames=50)
        for frame in skin.frames(timeout_s=2.0):
            print(f"frame {frame.sequence} over TCP: highest pixel {frame.map.max():.2f}")
