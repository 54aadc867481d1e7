"""A serial port: opened exclusively, read in the pieces that arrive, woken without polling.

pyserial configures the port; reading goes through ``poll`` and ``os.read``, which deliver a frame 0.03 ms after its
last byte. (``read(size)`` waits for a timeout, ``read_until`` reads byte by byte.) Driver exceptions are translated
here.
"""

import errno
import math
import os
import re
import select
import termios
from contextlib import suppress
from fcntl import ioctl
from typing import Final

import serial

from eitskin.errors import PortBusy, PortDenied, PortLost, PortMissing, TransportError

DEFAULT_BAUD: Final = 2_000_000
"""Carries 400 frames/s of 104 rows at 32 bit. USB ACM ports and pseudo-terminals ignore it."""

READ_BYTES: Final = 4096
"""Most bytes of one read; the kernel's line buffer is as long."""

WRITE_TIMEOUT_S: Final = 1.0
"""A request is under 100 bytes: a line that does not take it within this time is dead."""


class SerialPort:
    """An open serial port; the resource is released by ``close``.

    Args:
        port: Its path.
        baud: Bits per second on a real UART.

    Raises:
        PortMissing: No such port.
        PortBusy: Another program has it open.
        PortDenied: This user may not open it.
        TransportError: It exists and is no serial port.
    """

    def __init__(self, port: str, baud: int = DEFAULT_BAUD) -> None:
        self.name = port
        self._wake = -1
        try:
            self._serial = serial.Serial(port, baud, timeout=0, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
        except (serial.SerialException, ValueError, OSError, termios.error) as error:
            raise _open_error(port, error) from error
        self._fd: int = self._serial.fileno()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)
        self._poll.register(self._wake, select.POLLIN)
        # A pseudo-terminal keeps this flag until its master closes, so a killed runtime would lock it for good.
        self._locks_kernel = not os.path.realpath(port).startswith("/dev/pts/")
        if self._locks_kernel:
            with suppress(OSError):
                ioctl(self._fd, termios.TIOCEXCL)
        self._low_latency = self._ask_low_latency()
        clocked = re.match(r"/dev/tty(USB|S|AMA)\d", os.path.realpath(port))
        self.line_bytes_per_s = baud // 10 if clocked else 0
        """Ten bits a byte on a real UART; USB ACM ports and pseudo-terminals have no baud rate."""

    def _ask_low_latency(self) -> str:
        try:
            self._serial.set_low_latency_mode(True)
        except (ValueError, OSError, AttributeError, NotImplementedError):
            return "low-latency mode: not offered by this kind of port"
        return "low-latency mode: on"

    def report(self) -> list[str]:
        """Return the settings of the line, for people, a line each."""
        return [f"port {self.name}: open, exclusive", self._low_latency]

    def fileno(self) -> int:
        """Return the descriptor, for waiting on several lines at once."""
        return self._fd

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return what has arrived, waiting for the first byte; see :class:`eitskin.acquisition.transport.Transport`."""
        try:
            ready = self._poll.poll(None if timeout_s is None else max(0, math.ceil(timeout_s * 1000)))
            if not ready:
                return b""
            if len(ready) > 1 or ready[0][0] == self._wake:
                os.eventfd_read(self._wake)
                return b""
            data = os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._lost(error) from error
        if not data:
            raise self._lost(None)
        return data

    def write(self, data: bytes) -> None:
        """Send all of ``data``; see :class:`eitskin.acquisition.transport.Transport`."""
        try:
            self._serial.write(data)
        except (serial.SerialException, OSError, termios.error) as error:
            raise self._lost(error) from error

    def cancel(self) -> None:
        """Make the ``read`` that waits now, or else the next one, return at once."""
        if self._wake >= 0:
            os.eventfd_write(self._wake, 1)

    def close(self) -> None:
        """Give the port back; closing twice is fine."""
        if self._wake < 0:
            return
        if self._locks_kernel:
            with suppress(OSError):
                ioctl(self._fd, termios.TIOCNXCL)
        with suppress(OSError, serial.SerialException):
            self._serial.close()
        wake, self._wake = self._wake, -1  # in this order: ``cancel`` may come from a signal in between
        os.close(wake)

    def _lost(self, error: BaseException | None) -> PortLost:
        why = f" ({error})" if error is not None else ""
        return PortLost(f"{self.name} vanished{why}: check the cable and the power, then start again")


def _open_error(port: str, error: BaseException) -> TransportError:
    number = getattr(error, "errno", None)
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return PortMissing(f"no port {port}: plug the device in; 'eitskin doctor' lists the ports")
    if number in (errno.EBUSY, errno.EAGAIN):
        return PortBusy(f"{port} is open in another program: close it ('fuser {port}' names it), then start again")
    if number in (errno.EACCES, errno.EPERM):
        return PortDenied(f"{port} may not be opened by this user: 'sudo usermod -aG dialout $USER', then log in again")
    if isinstance(error, ValueError):
        return TransportError(f"{port}: {error}")
    return TransportError(f"{port} cannot be opened as a serial port: {error}")
