"""A line that is opened again when it vanishes, so that a pulled cable costs frames and not the program.

::

    read, write ──> open line ───PortLost──> wait for the port ──> open ──> PortReturned
                                                   └─ give_up_s passed ──> PortLost

A port that is not there yet, or that another program holds, is waited for in the same way. The device behind a port
that returns may be another one, or may have restarted: ``PortReturned`` tells the caller to repeat the handshake before
it uses a byte. A USB port may come back under another path, so it is found by vendor, product, serial number and
interface; any other port is found by its path.
"""

import math
import os
import select
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, InvalidStateError
from contextlib import suppress
from functools import partial
from typing import Any, Final

from eitskin.acquisition.drivers.driver import device_path, driver_name
from eitskin.acquisition.ports import open_line as open_any
from eitskin.acquisition.ports import serial_ports
from eitskin.acquisition.serial_port import DEFAULT_BAUD
from eitskin.acquisition.transport import Transport
from eitskin.errors import NotReady, PortBusy, PortDenied, PortLost, PortMissing, PortReturned, TransportError
from eitskin_proto.wire.framing import MAX_PAYLOAD
from eitskin_proto.wire.volts import LARGEST_VOLTS

LOOK_S: Final = 0.05
"""How often a port that vanished is looked for; nothing can be waited on while it is gone."""

BOOT_S: Final = 10.0
"""A board may boot for so long when its port is opened; opening the port again would only reset the board."""


def _name_of(found: Any) -> str:
    """Return what stays the same of a USB port, as pyserial describes it, when it returns under another path; or ""."""
    if found.vid is None or not found.serial_number:
        return ""
    interface = (found.location or "").partition(":")[2]  # of a device with several ports: 1.2
    return f"{found.vid:04x}:{found.pid:04x} {found.serial_number} {interface}".strip()


def usb_name(port: str) -> str:
    """Return the name by which a port is found again; "" if it is no USB port, or one without a serial number."""
    path = os.path.realpath(device_path(port))
    return next((_name_of(found) for found in serial_ports() if os.path.realpath(found.device) == path), "")


def port_named(name: str) -> str | None:
    """Return the path of the port of this name; None while it is not there."""
    return next((str(found.device) for found in serial_ports() if _name_of(found) == name), None)


def _open_for(opening: "Future[Transport]", open_line: Callable[[], Transport]) -> None:
    """Open a line for a caller that waits; close it again if nobody waits any more."""
    try:
        line = open_line()
    except Exception as error:
        with suppress(InvalidStateError):
            opening.set_exception(error)
        return
    try:
        opening.set_result(line)
    except InvalidStateError:
        line.close()


class HotPlug:
    """A transport that survives unplugging; see :class:`eitskin.acquisition.transport.Transport`.

    Args:
        port: Path of the port.
        baud: Bits per second on a real UART.
        give_up_s: How long to wait for a port that is gone; None waits until ``cancel``.
        open_line: Opens a path; a test gives its own.

    Raises:
        TransportError: The port can never be opened.
    """

    def __init__(
        self,
        port: str,
        baud: int = DEFAULT_BAUD,
        give_up_s: float | None = None,
        open_line: Callable[[str, int], Transport] = open_any,
    ) -> None:
        self.name = port
        self.returns = 0
        """How often the port vanished and came back."""
        self._baud = baud
        self._give_up_s = give_up_s
        self._open = open_line
        self._line: Transport | None = None
        self._usb = ""
        self._opened_s = -math.inf
        self._why: Exception | None = None
        try:
            self._take(port, open_line(port, baud))
        except (PortMissing, PortBusy, PortDenied, PortLost, NotReady) as error:
            self._why = error
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll = select.poll()
        self._poll.register(self._wake, select.POLLIN)

    @property
    def line_bytes_per_s(self) -> int:
        """Capacity of the line; 0 if no baud rate limits it, or while it is gone."""
        return 0 if self._line is None else self._line.line_bytes_per_s

    @property
    def largest_payload(self) -> int:
        """Bytes of a payload; more than the wire's where a driver sends volts."""
        return LARGEST_VOLTS if driver_name(self.name) else MAX_PAYLOAD

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return what has arrived, waiting for the first byte; nothing after the timeout or ``cancel``.

        Raises:
            PortReturned: The port vanished and is back: repeat the handshake.
            PortLost: It did not come back in time.
        """
        if self._line is None:
            return self._wait(None)
        try:
            return self._line.read(timeout_s)
        except PortLost as error:
            return self._wait(error)

    def write(self, data: bytes) -> None:
        """Send all of ``data``.

        Raises:
            PortReturned: The port vanished and is back: repeat the handshake.
            PortLost: It did not come back in time, or the waiting was cancelled.
        """
        cause: PortLost | None = None
        if self._line is not None:
            try:
                self._line.write(data)
                return
            except PortLost as error:
                cause = error
        self._wait(cause)
        raise PortLost(f"{self.name} is gone, and the wait for it was cancelled") from cause

    @property
    def trouble(self) -> str:
        """Why the port is not open, or what a driver received in place of scans; "" if nothing is known."""
        return str(self._why or "") if self._line is None else str(getattr(self._line, "trouble", ""))

    @property
    def patience_s(self) -> float:
        """How long a device may hang behind a port that is there; as long as a port may be gone."""
        return math.inf if self._give_up_s is None else self._give_up_s

    @property
    def gone(self) -> bool:
        """Whether the port has vanished and is not back."""
        return self._line is None

    def reopen(self) -> None:
        """Close the port and open it again; a hung device may then recover. A device that may still boot is left alone.

        Raises:
            PortReturned: It is open again: repeat the handshake.
            PortLost: It did not come back in time.
        """
        if time.perf_counter() - self._opened_s >= BOOT_S:
            self._wait(None)

    def _wait(self, cause: PortLost | None) -> bytes:
        """Wait for the port: raise when it is back or given up, return nothing when cancelled."""
        self._drop()
        deadline_s = None if self._give_up_s is None else time.perf_counter() + self._give_up_s
        while deadline_s is None or time.perf_counter() < deadline_s:
            if self._cancelled_within(LOOK_S):
                return b""
            try:
                if self._reopened():
                    raise PortReturned(f"{self.name} vanished and is back: repeat the handshake")
            except CancelledError:
                return b""
        if self._opened_s < 0.0:
            raise PortLost(f"waited {self._give_up_s:g} s: {self._why}")
        raise PortLost(
            f"{self.name} vanished and did not come back within {self._give_up_s:g} s: check the cable and the power"
        ) from cause

    def _reopened(self) -> bool:
        path = port_named(self._usb) if self._usb else device_path(self.name)
        if path is None:
            return False
        again, port = self._opened_s >= 0.0, self.name.replace(device_path(self.name), path)
        try:
            self._take(port, self._opened(port))
        except (TransportError, NotReady) as error:  # not there yet, or its permissions are not set yet
            self._why = error
            return False
        self.returns += again
        return True

    def _opened(self, port: str) -> Transport:
        """Return an open line. A driver may wait long for its device, so it opens in a thread, which ``cancel`` leaves.

        Raises:
            CancelledError: ``cancel`` was called.
        """
        if not driver_name(port):
            return self._open(port, self._baud)
        opening: Future[Transport] = Future()
        work = opening, partial(self._open, port, self._baud)
        threading.Thread(target=_open_for, args=work, name="eitskin-open", daemon=True).start()
        while not opening.done():
            if self._cancelled_within(LOOK_S):
                opening.cancel()
        return opening.result()

    def _cancelled_within(self, wait_s: float) -> bool:
        """Return whether ``cancel`` is called within a time, and forget it."""
        cancelled = bool(self._poll.poll(round(wait_s * 1000)))
        if cancelled:
            os.eventfd_read(self._wake)
        return cancelled

    def _take(self, port: str, line: Transport) -> None:
        self._line = line
        self.name, self._usb, self._opened_s = port, usb_name(port), time.perf_counter()

    def _drop(self) -> None:
        if self._line is not None:
            self._line.close()
            self._line = None

    def cancel(self) -> None:
        """Make the ``read`` that waits now, or else the next one, return at once; safe in a signal handler."""
        line = self._line
        if line is not None:
            line.cancel()
        if self._wake >= 0:
            os.eventfd_write(self._wake, 1)

    def report(self) -> list[str]:
        """Return the settings of the line, for people, a line each."""
        how = f"if it vanishes: looked for as {self._usb or self.name}"
        return [*([] if self._line is None else self._line.report()), how]

    def close(self) -> None:
        """Give the port back; closing twice is fine."""
        self._drop()
        if self._wake >= 0:
            wake, self._wake = self._wake, -1  # in this order: ``cancel`` may come from a signal in between
            os.close(wake)
