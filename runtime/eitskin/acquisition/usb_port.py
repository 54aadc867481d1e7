"""A USB device with vendor-specific bulk endpoints, as a transport; ``usb:`` or ``usb:SERIAL`` where a port is named.

The device is found by vendor, product and serial number, never by bus address, which changes with every plug. Reads ask
for a multiple of the endpoint's packet size, as the bus delivers whole packets. A read in libusb cannot be woken from
outside, so it blocks in slices, and ``cancel`` takes effect at the end of one. Driver exceptions are translated here.
"""

import errno
import math
import os
import time
from array import array
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import usb.core
import usb.util

from eitskin.acquisition.transport import USB_PREFIX
from eitskin.errors import PortBusy, PortDenied, PortLost, PortMissing, TransportError

VENDOR_ID: Final = 0x1209
PRODUCT_ID: Final = 0x0001
"""pid.codes' test pair, which no product may be sold with."""

READ_BYTES: Final = 4096
"""Bytes of one read, rounded up to whole packets."""

SLICE_MS: Final = 100
"""Longest block of one read before it checks for ``cancel``."""

WRITE_TIMEOUT_MS: Final = 1000
"""A request is under 100 bytes: a device that does not take it within this time is dead."""

MOST_STALLS: Final = 10
"""In a row, without a byte in between: a device that does nothing else is lost."""

VENDOR_CLASS: Final = 0xFF

RULE_FILE: Final = Path(__file__).with_name("60-eitskin.rules")
"""Lets users open the device; shipped with the package."""

RULE: Final = f"sudo cp {RULE_FILE} /etc/udev/rules.d/ and plug it in again"
"""Advice about permissions."""


@dataclass(frozen=True, slots=True)
class Found:
    """A device of ours on the bus, opened or not."""

    serial_number: str
    """Empty if this user may not read it, or there is none."""
    node: str
    """``/dev/bus/usb/001/002``; changes with every plug."""
    usable: bool
    """Whether this user may open it."""

    @property
    def port(self) -> str:
        """Advice about a port's name."""
        return f"{USB_PREFIX}{self.serial_number}"


def devices(backend: Any = None) -> list[Found]:
    """Return the devices of ours that are on the bus.

    Raises:
        TransportError: libusb is not installed.
    """
    listed = []
    for device in _ours(backend):
        node = f"/dev/bus/usb/{device.bus or 0:03}/{device.address or 0:03}"
        usable = not os.path.exists(node) or os.access(node, os.R_OK | os.W_OK)
        listed.append(Found(_serial(device), node, usable))
        with suppress(usb.core.USBError):
            usb.util.dispose_resources(device)
    return listed


class UsbPort:
    """An open USB device; the resource is released by ``close``.

    Args:
        port: ``usb:SERIAL``, or ``usb:`` for the only one there is.
        backend: pyusb's; a test gives its own.

    Raises:
        PortMissing: No such device, or several and no serial number.
        PortBusy: Another program has its interface.
        PortDenied: This user may not open it.
        TransportError: It has no pair of vendor-specific bulk endpoints.
    """

    line_bytes_per_s = 0
    """No baud rate limits USB; full speed carries every configuration."""

    def __init__(self, port: str = USB_PREFIX, backend: Any = None) -> None:
        self.name = port
        self._closed = False
        self._cancelled = False
        self._stalls = 0
        self._device = _find(port.removeprefix(USB_PREFIX), backend)
        try:
            self._interface, self._in, self._out = _claim(self._device)
        except usb.core.USBError as error:
            raise _open_error(port, error) from error
        packet = self._in.wMaxPacketSize
        self._buffer = array("B", bytes(-(-READ_BYTES // packet) * packet))

    def report(self) -> list[str]:
        """Return the settings of the line, for people, a line each."""
        return [f"port {self.name}: {_serial(self._device)}, packets of {self._in.wMaxPacketSize} bytes"]

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return what has arrived, waiting for the first byte; see :class:`eitskin.acquisition.transport.Transport`."""
        deadline_s = None if timeout_s is None else time.perf_counter() + timeout_s
        while not self._cancelled:
            left_ms = SLICE_MS if deadline_s is None else math.ceil((deadline_s - time.perf_counter()) * 1000)
            data = self._read_once(max(1, min(SLICE_MS, left_ms)))
            if data or (deadline_s is not None and time.perf_counter() >= deadline_s):
                return data
        self._cancelled = False
        return b""

    def _read_once(self, timeout_ms: int) -> bytes:
        try:
            count = self._in.read(self._buffer, timeout_ms)
        except usb.core.USBTimeoutError:
            return b""
        except usb.core.USBError as error:
            if error.errno != errno.EPIPE:
                raise self._lost(error) from error
            self._clear_stall(error)
            return b""
        self._stalls = 0
        return self._buffer[:count].tobytes()

    def _clear_stall(self, stall: usb.core.USBError) -> None:
        """A stalled endpoint stays so until the host clears it; its bytes are lost, and the framing recovers."""
        self._stalls += 1
        if self._stalls > MOST_STALLS:
            raise self._lost(stall)
        try:
            self._in.clear_halt()
        except usb.core.USBError as error:
            raise self._lost(error) from error

    def write(self, data: bytes) -> None:
        """Send all of ``data``; see :class:`eitskin.acquisition.transport.Transport`."""
        sent = 0
        while sent < len(data):
            try:
                sent += self._out.write(data[sent:], WRITE_TIMEOUT_MS)
            except usb.core.USBError as error:
                raise self._lost(error) from error

    def cancel(self) -> None:
        """Make the ``read`` that waits now, or else the next one, return within a slice."""
        self._cancelled = True

    def close(self) -> None:
        """Give the device back; closing twice is fine."""
        if self._closed:
            return
        self._closed = True
        with suppress(usb.core.USBError):
            usb.util.release_interface(self._device, self._interface)
        with suppress(usb.core.USBError):
            usb.util.dispose_resources(self._device)

    def _lost(self, error: usb.core.USBError) -> PortLost:
        return PortLost(f"{self.name} vanished ({error}): check the cable and the power, then start again")


def _serial(device: Any) -> str:
    try:
        return str(device.serial_number or "")
    except (usb.core.USBError, ValueError):  # pyusb: no permission to read its strings
        return ""


def _ours(backend: Any) -> list[Any]:
    try:
        return list(usb.core.find(find_all=True, idVendor=VENDOR_ID, idProduct=PRODUCT_ID, backend=backend))
    except usb.core.NoBackendError as error:
        raise TransportError("libusb is not installed: apt-get install libusb-1.0-0") from error
    except usb.core.USBError as error:
        raise TransportError(f"the USB devices cannot be listed ({error}): try again") from error


def _find(serial_number: str, backend: Any) -> Any:
    found = _ours(backend)
    if serial_number:
        found = [device for device in found if _serial(device) == serial_number]
    if not found:
        which = f" with serial number {serial_number}" if serial_number else ""
        raise PortMissing(
            f"found no USB device {VENDOR_ID:04x}:{PRODUCT_ID:04x}{which}: plug it in; if it is plugged in, give this "
            "user access: " + RULE
        )
    if len(found) > 1:
        names = ", ".join(f"{USB_PREFIX}{_serial(device)}" for device in found)
        raise PortMissing(f"{len(found)} USB devices match: name one of {names}")
    return found[0]


def _claim(device: Any) -> tuple[int, Any, Any]:
    """Return interface number, IN and OUT endpoint of the vendor-specific interface, claimed for us alone.

    An active configuration stays: another driver may hold another interface of the device, such as its serial port.
    """
    try:
        configuration = device.get_active_configuration()
    except usb.core.USBError:  # none is active
        device.set_configuration()
        configuration = device.get_active_configuration()
    for interface in configuration:
        ends = {usb.util.endpoint_direction(end.bEndpointAddress): end for end in interface if _is_bulk(end)}
        if interface.bInterfaceClass == VENDOR_CLASS and len(ends) == 2:
            usb.util.claim_interface(device, interface.bInterfaceNumber)
            if interface.bAlternateSetting:
                interface.set_altsetting()
            return interface.bInterfaceNumber, ends[usb.util.ENDPOINT_IN], ends[usb.util.ENDPOINT_OUT]
    raise TransportError(
        f"USB device {VENDOR_ID:04x}:{PRODUCT_ID:04x} has no vendor-specific interface with a bulk endpoint in each "
        "direction: another firmware, or another device with the same test ids"
    )


def _is_bulk(endpoint: Any) -> bool:
    return bool(usb.util.endpoint_type(endpoint.bmAttributes) == usb.util.ENDPOINT_TYPE_BULK)


def _open_error(port: str, error: usb.core.USBError) -> TransportError:
    if error.errno == errno.EBUSY:
        return PortBusy(f"{port} is open in another program: close it, then start again")
    if error.errno in (errno.EACCES, errno.EPERM):
        return PortDenied(f"{port} may not be opened by this user: {RULE}")
    if error.errno == errno.ENODEV:
        return PortMissing(f"{port} was unplugged while it was opened")
    return TransportError(f"{port} cannot be opened: {error}")
