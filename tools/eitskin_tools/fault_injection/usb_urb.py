"""The kernel's side of one mocked USB device: what usbdevfs answers to each ioctl, URB by URB.

::

    SUBMITURB ─> waiting ─┬─ bytes from the device ─> done: ends on a short packet, or when its buffer is full
                          ├─ more bytes than a buffer of no whole packets takes ─> EOVERFLOW
                          ├─ DISCARDURB ─> ENOENT        ├─ endpoint halted ─> EPIPE until CLEAR_HALT
                          └─ unplugged ─> ENODEV                                     REAPURB gives them back
"""

import errno
import struct
import threading
from dataclasses import dataclass
from typing import Any, Final

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
        self.halted = False
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
        elif request == CLEAR_HALT:
            self.halted = False
        elif request != SETCONFIGURATION:
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
        if self.halted:
            return -errno.EPIPE, None
        if not self.to_host:
            return None
        if urb.length % PACKET and len(self.to_host) > urb.length:
            return -errno.EOVERFLOW, None  # the last packet does not fit into what is left of the buffer
        data = bytes(self.to_host[: urb.length])
        del self.to_host[: len(data)]
        return 0, data
