"""Which transport a port's name means: ``usb:`` and ``usb:SERIAL`` are USB devices, all else is a serial path."""

from eitskin.acquisition.serial_port import DEFAULT_BAUD, SerialPort
from eitskin.acquisition.transport import USB_PREFIX, Transport


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
    from eitskin.acquisition.usb_port import UsbPort  # noqa: PLC0415 -- pyusb is only loaded by who uses it

    return UsbPort(port)
