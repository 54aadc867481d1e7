"""Chooses the transport for a port's name.

``usb:`` and ``usb:SERIAL`` are USB devices, ``NAME:REST`` is a device behind the driver NAME
(:mod:`eitskin.acquisition.drivers.driver`), all else is a serial path.
"""

from typing import Any, Final

from serial.tools import list_ports

from eitskin.acquisition.drivers.driver import driver_name, open_driver
from eitskin.acquisition.serial_port import DEFAULT_BAUD, SerialPort
from eitskin.acquisition.transport import USB_PREFIX, Transport
from eitskin.errors import PortMissing

LOOKS: Final = 3
"""At the serial ports, if one of them comes or goes just then."""


def serial_ports() -> list[Any]:
    """Return the serial ports that are there, as pyserial describes them.

    pyserial fails if a port comes or goes while it is read; then it is read again.
    """
    for _ in range(LOOKS):
        try:
            return list(list_ports.comports())
        except (OSError, TypeError, ValueError):
            continue
    return []


def open_line(port: str, baud: int = DEFAULT_BAUD) -> Transport:
    """Return an open line.

    Args:
        port: ``/dev/ttyACM0``, ``usb:``, ``usb:SERIAL`` or ``NAME:REST``, such as ``line:/dev/ttyACM0?numbers=256``.
        baud: Bits per second on a real UART; a driver has an option of its own.

    Raises:
        HandshakeError: The device of a driver sends nothing that can be used.
        TransportError: It cannot be opened; the branch and the text say why.
    """
    if not port:
        raise PortMissing("port is empty, expected a path such as /dev/ttyACM0, or usb:SERIAL")
    if driver_name(port):
        from eitskin.acquisition.drivers.feed import line_of  # noqa: PLC0415 -- few devices have a driver

        return line_of(open_driver(port), port)
    if not port.startswith(USB_PREFIX):
        return SerialPort(port, baud)
    from eitskin.acquisition.usb_port import UsbPort  # noqa: PLC0415 -- pyusb is only loaded by who uses it

    return UsbPort(port)
