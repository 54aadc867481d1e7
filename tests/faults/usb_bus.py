"""The device's end of a mocked USB bus: umockdev catches libusb's system calls, and this module is the kernel for them.

::

    pyusb, libusb (real)          umockdev                    here
    open /dev/bus/usb/001/002 --> LD_PRELOAD --> socket --> ioctl SUBMITURB, REAPURBNDELAY, CLAIMINTERFACE, ...
                                                            IN FIFO of a device, OUT bytes, plug, stall, restart

    SUBMITURB ─> waiting ─┬─ bytes from the device ─> done: ends on a short packet, or when its buffer is full
                          ├─ DISCARDURB ─> ENOENT
                          └─ unplugged ─> ENODEV                                     REAPURB gives them back

:class:`BusPort` is a :class:`eitskin_tools.virtual_skin.server.Port`: the virtual skin's server and faults run behind
it.
Each plug gets a new device number, as on a real bus. What a URB is, how it ends on a short packet or is cut short by an
unplug, follows the kernel's usbdevfs.
"""

import errno
import importlib
import os
import struct
import sys
import threading
from dataclasses import dataclass
from typing import Any, Final

from eitskin.acquisition.usb_port import PRODUCT_ID, VENDOR_ID
from eitskin_proto.errors import SkinError

FIFO_BYTES: Final = 16384
"""What the device keeps for a host that does not read; a packet that has no room is dropped whole."""

PACKET: Final = 64
"""``wMaxPacketSize`` of full-speed bulk endpoints."""

HOLD_S: Final = 0.002
"""How long a reaping call without a result is held: libusb polls a plain file here, which is always ready."""

IN, OUT, CONTROL = 0x81, 0x01, 2

SETCONFIGURATION, SUBMITURB, DISCARDURB, REAPURB, REAPURBNDELAY = 0x05, 0x0A, 0x0B, 0x0C, 0x0D
CLAIMINTERFACE, RELEASEINTERFACE, CLEAR_HALT, GET_CAPABILITIES = 0x0F, 0x10, 0x15, 0x1A
"""Numbers of usbdevfs' ioctls, the lowest byte of a request."""

URB: Final = struct.Struct("<BBxxiIxxxxQiiiiIxxxxQ")
"""``struct usbdevfs_urb`` on 64-bit machines: type, endpoint, status, flags, buffer, length, actual, ..., context."""

STATUS_AT, ACTUAL_AT, BUFFER_AT = 4, 28, 16

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


@dataclass(slots=True, eq=False)
class _Urb:
    """A request that the host submitted and has not reaped."""

    client: Any
    """The open descriptor that it belongs to: only this one may reap it."""
    urb: Any
    buffer: Any
    address: int
    endpoint: int
    length: int
    result: tuple[int, bytes | None] | None = None
    """Status and, for IN, the bytes; None while it waits."""


class Plugged:
    """One device number on the bus, from a plug to the next unplug: the state that usbdevfs keeps for it."""

    def __init__(self, serial_number: str) -> None:
        self.serial_number = serial_number
        self.changed = threading.Condition()
        self.to_host = bytearray()
        self.to_device = bytearray()
        self.gone = False
        self.urbs: list[_Urb] = []
        self._claimant: Any = None

    def answer(self, client: Any) -> None:
        """Do what one ioctl asks for, and complete it."""
        request, argument = client.get_request() & 0xFF, client.get_arg()
        with self.changed:
            if request in (REAPURB, REAPURBNDELAY):
                self._reap(client, argument)
                return
            code = errno.ENODEV if self.gone else self._do(request, client, argument)
        client.complete(-1 if code else 0, code)

    def _do(self, request: int, client: Any, argument: Any) -> int:
        """Return 0 or the error number of a request other than reaping."""
        if request == SUBMITURB:
            return self._submit(client, argument)
        if request == DISCARDURB:
            return self._discard(client, int.from_bytes(bytes(argument.retrieve()), "little"))
        if request == GET_CAPABILITIES:
            argument.resolve(0, 4).update(0, (0).to_bytes(4, "little"))
        elif request == CLAIMINTERFACE:
            if self._claimant not in (None, client):
                return errno.EBUSY
            self._claimant = client
        elif request == RELEASEINTERFACE:
            self._claimant = None
        elif request not in (SETCONFIGURATION, CLEAR_HALT):
            return errno.ENOTTY
        return 0

    def leave(self, client: Any) -> None:
        """Forget a host that closed its descriptor."""
        with self.changed:
            if self._claimant == client:
                self._claimant = None
            self.urbs = [urb for urb in self.urbs if urb.client != client]

    def _submit(self, client: Any, argument: Any) -> int:
        urb = argument.resolve(0, URB.size)
        fields = URB.unpack(bytes(urb.retrieve()))
        kind, endpoint, length = fields[0], fields[1], fields[5]
        made = _Urb(client, urb, urb.resolve(BUFFER_AT, length), urb.client_addr, endpoint, length)
        if kind == CONTROL:
            made.result = self._control(bytes(made.buffer.retrieve()))
        elif endpoint == OUT:
            self.to_device += bytes(made.buffer.retrieve())
            made.result = (0, None)
        self.urbs.append(made)
        self.changed.notify_all()
        return 0

    def _control(self, setup: bytes) -> tuple[int, bytes | None]:
        request_type, request, value, _index, length = struct.unpack_from("<BBHHH", setup)
        if (request_type, request, value >> 8) != (0x80, 6, 3):  # only string descriptors are asked for
            return -errno.EPIPE, None
        text = b"\x09\x04" if value & 0xFF == 0 else self.serial_number.encode("utf-16-le")
        return 0, bytes((len(text) + 2, 3)) + text[: length - 2]

    def _discard(self, client: Any, address: int) -> int:
        for urb in self.urbs:
            if urb.client == client and urb.address == address and urb.result is None:
                urb.result = (-errno.ENOENT, None)
                return 0
        return errno.EINVAL

    def _reap(self, client: Any, argument: Any) -> None:
        found = self._finished(client)
        if found is None and not self.gone:
            self.changed.wait(HOLD_S)
            found = self._finished(client)
        if found is None:
            client.complete(-1, errno.ENODEV if self.gone else errno.EAGAIN)
            return
        self.urbs.remove(found)
        status, data = found.result or (0, None)
        offset = 0 if found.endpoint in (IN, OUT) else 8  # a control transfer's buffer begins with its setup
        if data is not None and found.buffer is not None:
            found.buffer.update(offset, data[: found.length - offset])
        actual = found.length if data is None and status == 0 else len(data or b"")
        found.urb.update(STATUS_AT, status.to_bytes(4, "little", signed=True))
        found.urb.update(ACTUAL_AT, actual.to_bytes(4, "little"))
        argument.resolve(0, 8).set_ptr(0, found.urb)
        client.complete(0, 0)

    def _finished(self, client: Any) -> _Urb | None:
        """Return a URB of this descriptor that has its result, giving waiting ones what has arrived."""
        for urb in self.urbs:
            if urb.client != client:
                continue
            if urb.result is None:
                urb.result = self._arrived(urb)
            if urb.result is not None:
                return urb
        return None

    def _arrived(self, urb: _Urb) -> tuple[int, bytes | None] | None:
        if self.gone:
            return -errno.ENODEV, None
        if not self.to_host:
            return None
        data = bytes(self.to_host[: urb.length])
        del self.to_host[: len(data)]
        return 0, data


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
        # Before the node: umockdev ends a program that opens a node that is not served yet.
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
            room = len(self._now.to_host) + len(data) <= FIFO_BYTES
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
