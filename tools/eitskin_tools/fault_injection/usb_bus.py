"""The device's end of a mocked USB bus: umockdev catches libusb's system calls, and this module is the kernel for them.

::

    pyusb, libusb (real)          umockdev                    here
    open /dev/bus/usb/001/002 --> LD_PRELOAD --> socket --> ioctl SUBMITURB, REAPURBNDELAY, CLAIMINTERFACE, ...
                                                            IN FIFO of a device, OUT bytes, plug, stall, restart

:class:`BusPort` is a :class:`eitskin_tools.virtual_skin.port.Port`: the virtual skin's server and faults run behind it.
Each plug gets a new device number, as on a real bus. What a URB is, how it ends on a short packet, overflows if its
buffer is no whole number of packets, or is cut short by an unplug, follows the kernel's usbdevfs.
"""

import importlib
import os
import struct
import sys
import threading
from typing import Any, Final

from eitskin.acquisition.usb_port import PRODUCT_ID, VENDOR_ID
from eitskin_proto.errors import SkinError
from eitskin_tools.fault_injection.usb_urb import IN, OUT, PACKET, Plugged

FIFO_BYTES: Final = 16384
"""What the device keeps for a host that does not read; a packet that has no room is dropped whole."""

DEBIAN_PACKAGES: Final = "/usr/lib/python3/dist-packages"
"""Where ``gi`` is; it is not on PyPI as a wheel."""


def bindings() -> tuple[Any, Any]:
    """Return ``UMockdev`` and ``GLib``, GObject introspection's view of the C libraries.

    Raises:
        SkinError: They are not installed, or for another version of Python.
    """
    if DEBIAN_PACKAGES not in sys.path:
        sys.path.append(DEBIAN_PACKAGES)
    try:
        gi: Any = importlib.import_module("gi")
        gi.require_version("UMockdev", "1.0")
        return importlib.import_module("gi.repository.UMockdev"), importlib.import_module("gi.repository.GLib")
    except (ImportError, ValueError, AttributeError) as error:
        raise SkinError(
            f"umockdev cannot be used ({error}): apt-get install umockdev gir1.2-umockdev-1.0 python3-gi, with "
            "Debian's own version of Python"
        ) from error


def descriptors() -> bytes:
    """Return device and configuration descriptor: one vendor-specific interface, bulk IN and OUT."""
    device = struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x200, 0, 0, 0, 64, VENDOR_ID, PRODUCT_ID, 0x100, 0, 0, 3, 1)
    endpoints = b"".join(struct.pack("<BBBBHB", 7, 5, address, 2, PACKET, 0) for address in (IN, OUT))
    interface = struct.pack("<BBBBBBBBB", 9, 4, 0, 0, 2, 0xFF, 0, 0, 0)
    return device + struct.pack("<BBHBBBBB", 9, 2, 9 + 9 + 14, 1, 1, 0, 0x80, 50) + interface + endpoints


class BusPort:
    """The device's side of the bus, with the interface of :class:`eitskin_tools.virtual_skin.pty.PtyPort`."""

    unsent = False
    """A packet is in the FIFO whole, or dropped."""

    restart_s = 0.15
    """How long the device is away from the bus when it restarts."""

    def __init__(self, serial_number: str) -> None:
        """Make the bus and plug the device in.

        Raises:
            SkinError: umockdev cannot be used.
        """
        umockdev, glib = bindings()
        self.serial_number = serial_number
        self.overruns = 0
        """Packets dropped because the host did not read."""
        self._bed = umockdev.Testbed.new()
        self._handler = _handler_class(umockdev)
        self._number = 1
        self._now: Plugged | None = None
        self._handlers: list[Any] = []
        self._stalls = False
        self._bell = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        threading.Thread(target=glib.MainLoop().run, daemon=True).start()
        self.plug()

    @property
    def plugged(self) -> bool:
        """Whether the host can find the device."""
        return self._now is not None

    def fileno(self) -> int:
        """Return a descriptor that is readable when the host has written."""
        return self._bell

    @property
    def environment(self) -> dict[str, str]:
        """What a host needs in its environment to see this bus instead of the machine's own."""
        return {"LD_PRELOAD": os.environ.get("LD_PRELOAD", ""), "UMOCKDEV_DIR": str(self._bed.get_root_dir())}

    def plug(self) -> None:
        """Make the device appear under a new number; nothing happens if it is there."""
        if self.plugged:
            return
        self._number = self._number % 126 + 1 if self._number > 1 else 2
        node = f"bus/usb/001/{self._number:03}"
        plugged = Plugged(self.serial_number)
        handler = self._handler(plugged, self._ring)
        self._handlers.append(handler)  # the bed does not own it
        # Before the node: umockdev ends a program that opens a node which nobody serves yet.
        self._bed.attach_ioctl(f"/dev/{node}", handler)
        self._bed.add_from_string(
            f"P: /devices/1-1\nN: {node}\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\nE: DEVNAME=/dev/{node}\n"
            f"E: BUSNUM=001\nE: DEVNUM={self._number:03}\nA: busnum=1\\n\nA: devnum={self._number}\\n\nA: speed=12\\n\n"
            f"A: bConfigurationValue=1\\n\nH: descriptors={descriptors().hex().upper()}\n"
        )
        self._now = plugged
        self._bed.uevent("/sys/devices/1-1", "add")

    def unplug(self) -> None:
        """Make the device vanish: what the host waits for fails with ENODEV."""
        if self._now is None:
            return
        with self._now.changed:
            self._now.gone = True
            self._now.changed.notify_all()
        self._now = None
        self._bed.uevent("/sys/devices/1-1", "remove")
        self._bed.remove_device("/sys/devices/1-1")

    def stall(self) -> None:
        """Halt the IN endpoint at the next packet, which is lost with what the FIFO holds, until the host clears it."""
        self._stalls = True

    def read(self) -> bytes:
        """Return what the host has written, without waiting."""
        try:
            os.eventfd_read(self._bell)
        except BlockingIOError:
            return b""
        if self._now is None:
            return b""
        with self._now.changed:
            data = bytes(self._now.to_device)
            self._now.to_device.clear()
        return data

    def flush(self) -> None:
        """Nothing waits for room."""

    def write(self, data: bytes) -> bool:
        """Put one packet into the FIFO, whole or not at all.

        Returns:
            False if there was no room, or no cable.
        """
        if self._now is None:
            return False
        with self._now.changed:
            if self._stalls:
                self._stalls, self._now.halted = False, True
                self._now.to_host.clear()
                self._now.changed.notify_all()
            room = len(self._now.to_host) + len(data) <= FIFO_BYTES and not self._now.halted
            if room:
                self._now.to_host += data
                self._now.changed.notify_all()
        self.overruns += not room
        return room

    def write_all(self, data: bytes, timeout_s: float) -> bool:
        """Send an answer; the FIFO has room for it, or the host does not listen."""
        return self.write(data)

    def close(self) -> None:
        """Unplug for good."""
        self.unplug()
        os.close(self._bell)

    def _ring(self) -> None:
        os.eventfd_write(self._bell, 1)


def _handler_class(umockdev: Any) -> Any:
    """Return the class through which umockdev asks; it can only be made once the bindings are loaded."""

    class Handler(umockdev.IoctlBase):  # type: ignore[misc]
        def __init__(self, plugged: Plugged, ring: Any) -> None:
            super().__init__()
            self.plugged, self.ring = plugged, ring

        def do_handle_ioctl(self, client: Any) -> bool:
            self.plugged.answer(client)
            if self.plugged.to_device:
                self.ring()
            return True

        def do_client_vanished(self, client: Any) -> None:
            self.plugged.leave(client)

    return Handler
