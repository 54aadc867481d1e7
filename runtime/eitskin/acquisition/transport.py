"""The interface of a line to a device, which serial ports, USB endpoints and sockets in tests implement.

Code above it knows neither pyserial nor pyusb: an implementation translates its driver's exceptions into the branches
of :class:`eitskin.errors.TransportError`.
"""

from typing import Any, Final, Protocol

USB_PREFIX: Final = "usb:"
"""Prefix of the port name of a USB device."""


class Transport(Protocol):
    """A full-duplex byte stream that blocks in ``read`` and can be woken from another thread or a signal handler."""

    @property
    def name(self) -> str:
        """Name of the line for people, such as ``/dev/ttyACM0``."""

    @property
    def line_bytes_per_s(self) -> int:
        """Capacity of the line; 0 if no baud rate limits it."""

    def read(self, timeout_s: float | None = None) -> bytes:
        """Wait for the first byte, then return all that have arrived.

        Args:
            timeout_s: How long to wait; None waits without limit.

        Returns:
            At least one byte, or none after the timeout or ``cancel``.

        Raises:
            PortLost: The line is gone.
        """

    def write(self, data: bytes) -> None:
        """Send all of ``data``.

        Raises:
            PortLost: The line is gone or takes no bytes.
        """

    def cancel(self) -> None:
        """Make the current ``read``, or else the next one, return at once.

        It must not take a lock that ``read`` or ``write`` hold, because signal handlers call it during them.
        """

    def report(self) -> list[str]:
        """Return lines for people that describe the line's settings."""

    def close(self) -> None:
        """Close the line; a second call does nothing."""


class WrappedTransport:
    """A transport that forwards to another one; a subclass overrides some methods.

    Optional attributes are forwarded as well: ``patience_s``, ``pause_s``, ``gone``, ``reopen``.

    Args:
        line: The other.
    """

    __slots__ = ("_line",)

    def __init__(self, line: Transport) -> None:
        self._line = line

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the other transport that this class does not define, unless it is private."""
        if name.startswith("_"):  # such as _line itself, before there is one
            raise AttributeError(f"{type(self).__name__} has no {name}")
        return getattr(self._line, name)

    @property
    def name(self) -> str:
        """Name of the line for people."""
        return self._line.name

    @property
    def line_bytes_per_s(self) -> int:
        """Capacity of the line; 0 if no baud rate limits it."""
        return self._line.line_bytes_per_s

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return whatever has arrived, waiting for the first byte."""
        return self._line.read(timeout_s)

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""
        self._line.write(data)

    def cancel(self) -> None:
        """Make the ``read`` that waits now, or else the next one, return at once."""
        self._line.cancel()

    def report(self) -> list[str]:
        """Return the settings of the line, for people, a line each."""
        return self._line.report()

    def close(self) -> None:
        """Give the line back."""
        self._line.close()
