"""What the virtual skin needs of a line: bytes both ways, and a plug that can be pulled."""

from typing import Protocol


class Port(Protocol):
    """The device's end of a line with a plug: a pseudo-terminal, or a mocked USB bus."""

    restart_s: float
    """How long the device is gone from the line when it restarts; 0 if the line does not notice."""

    @property
    def plugged(self) -> bool:
        """Whether the host can open the port."""

    @property
    def unsent(self) -> bool:
        """Whether the rest of a packet waits for room."""

    def fileno(self) -> int:
        """Return the descriptor that is readable when the host has written."""

    def plug(self) -> None:
        """Make the port appear."""

    def unplug(self) -> None:
        """Make the port vanish."""

    def read(self) -> bytes:
        """Return what the host has written, without waiting."""

    def flush(self) -> None:
        """Send what is left of a packet, as far as there is room."""

    def write(self, data: bytes) -> bool:
        """Send one packet, whole or not at all; False if it was dropped."""

    def write_all(self, data: bytes, timeout_s: float) -> bool:
        """Send bytes that may not be dropped, waiting for room."""
