"""Which transport a port's name means: ``usb:`` and ``usb:SERIAL`` are USB devices, all else is a serial path."""

from eitskin.serial_port import DEFAULT_BAUD, SerialPort
from eitskin.transport import Transport

USB_PREFIX = "usb:"
"""What the name of a port starts with if it is a USB device."""


def open_line(port: str, baud: int = DEFAULT_BAUD) -> Transport:
    """Return an open line.

    Args:
        port: ``/dev/ttyACM0``, ``usb:`` or ``usb:SERIAL``.
        baud: Bits per second on a real UART.

    Raises:
        TransportError: It cannot be opened; the branch and the text say why.
    """
    if not port.startswith(USB_PREFIX):
        return SerialPort(port, baud)
    from eitskin.usb_port import UsbPort  # noqa: PLC0415 -- pyusb is only loaded by who uses it

    return UsbPort(port)
