"""The USB transport through real pyusb, on a backend that plays a device: find, stream, timeout, stall, unplug."""

import errno
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import usb.backend
import usb.core

from eitskin.acquisition import ports, usb_port
from eitskin.acquisition.usb_port import PRODUCT_ID, VENDOR_ID, UsbPort
from eitskin.errors import PortBusy, PortDenied, PortLost, PortMissing, TransportError

IN, OUT, PACKET = 0x81, 0x01, 64


class Played(usb.backend.IBackend):
    """Devices as pyusb's backends see them: descriptors, and one queue of bytes each way."""

    def __init__(self, *serials, interface_class=0xFF):
        self.serials, self.interface_class = list(serials), interface_class
        self.configuration, self.alternate, self.altered = 1, 0, []
        self.to_host, self.to_device = bytearray(), bytearray()
        self.fails, self.open_fails, self.claimed, self.halts, self.asked = [], None, set(), 0, []

    def enumerate_devices(self):
        return iter(list(self.serials))

    def get_device_descriptor(self, dev):
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x0200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
            bMaxPacketSize0=64, idVendor=VENDOR_ID, idProduct=PRODUCT_ID, bcdDevice=0x100, iManufacturer=0, iProduct=0,
            iSerialNumber=3, bNumConfigurations=1, address=1, bus=1, port_number=1, port_numbers=(1,), speed=2,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev, config):
        if config:
            raise IndexError
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=32, bNumInterfaces=1, bConfigurationValue=1, iConfiguration=0,
            bmAttributes=0x80, bMaxPower=50, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev, intf, alt, config):
        if intf or config or alt > self.alternate:
            raise IndexError
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=alt,
            bNumEndpoints=2 * (alt == self.alternate),
            bInterfaceClass=self.interface_class, bInterfaceSubClass=0, bInterfaceProtocol=0, iInterface=0,
            extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev, ep, intf, alt, config):
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=(IN, OUT)[ep], bmAttributes=2, wMaxPacketSize=PACKET,
            bInterval=0, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev):
        return dev

    def close_device(self, handle):
        pass

    def get_configuration(self, handle):
        return self.configuration

    def set_configuration(self, handle, value):
        if self.configuration:  # as Linux says while a driver holds another interface
            raise usb.core.USBError("busy", errno=errno.EBUSY)
        self.configuration = value

    def claim_interface(self, handle, intf):
        if self.open_fails:
            raise usb.core.USBError("refused", errno=self.open_fails)
        self.claimed.add(intf)

    def set_interface_altsetting(self, handle, intf, altsetting):
        self.altered.append((intf, altsetting))

    def release_interface(self, handle, intf):
        self.claimed.discard(intf)

    def ctrl_transfer(self, handle, request_type, request, value, index, data, timeout):
        text = b"\x09\x04" if value & 0xFF == 0 else handle.encode("utf-16-le")
        raw = bytes([len(text) + 2, 3]) + text
        count = min(len(raw), len(data))
        data[:count] = type(data)("B", raw[:count])
        return count

    def clear_halt(self, handle, ep):
        self.halts += 1

    def bulk_write(self, handle, ep, intf, data, timeout):
        self._fail()
        taken = bytes(data)[:PACKET]  # a device may take less than all
        self.to_device += taken
        return len(taken)

    def bulk_read(self, handle, ep, intf, buff, timeout):
        self._fail()
        self.asked.append(len(buff))
        if not self.to_host:
            time.sleep(min(timeout, 5) / 1000)
            raise usb.core.USBTimeoutError("nothing", errno=errno.ETIMEDOUT)
        count = min(len(buff), len(self.to_host))
        buff[:count] = type(buff)("B", bytes(self.to_host[:count]))
        del self.to_host[:count]
        return count

    def _fail(self):
        if self.fails:
            number = self.fails.pop(0)
            raise usb.core.USBError("failed", errno=number)


def test_a_device_is_found_by_its_serial_number_and_only_if_it_is_unambiguous():
    backend = Played("SKIN-1", "SKIN-2")
    port = UsbPort("usb:SKIN-2", backend)
    assert port.report() == ["port usb:SKIN-2: SKIN-2, packets of 64 bytes"]
    assert backend.claimed == {0}
    port.close()
    port.close()
    assert backend.claimed == set()
    with pytest.raises(PortMissing, match="2 USB devices match: name one of usb:SKIN-1, usb:SKIN-2"):
        UsbPort("usb:", backend)
    with pytest.raises(PortMissing, match="no USB device 1209:0001 with serial number SKIN-3"):
        UsbPort("usb:SKIN-3", backend)
    with pytest.raises(PortMissing, match="no USB device 1209:0001: plug it in"):
        UsbPort("usb:", Played())


@pytest.mark.parametrize("active", [1, 0])
def test_only_a_device_without_an_active_configuration_is_configured(active):
    backend = Played("SKIN-1")
    backend.configuration = active
    UsbPort("usb:", backend).close()
    assert backend.configuration == 1


@pytest.mark.parametrize(("alternate", "altered"), [(0, []), (1, [(0, 1)])])
def test_the_setting_that_has_the_endpoints_is_selected(alternate, altered):
    backend = Played("SKIN-1")
    backend.alternate = alternate
    UsbPort("usb:", backend).close()
    assert backend.altered == altered


@pytest.mark.parametrize(
    ("number", "error"),
    [(errno.EBUSY, PortBusy), (errno.EACCES, PortDenied), (errno.ENODEV, PortMissing), (errno.EIO, TransportError)],
)
def test_a_device_that_cannot_be_opened_says_why(number, error):
    backend = Played("SKIN-1")
    backend.open_fails = number
    with pytest.raises(error):
        UsbPort("usb:", backend)


def test_a_device_without_the_endpoints_is_refused():
    with pytest.raises(TransportError, match="no vendor-specific interface with a bulk endpoint in each direction"):
        UsbPort("usb:", Played("SKIN-1", interface_class=3))


def test_bytes_pass_whole_in_both_directions_and_reads_ask_for_whole_packets():
    backend = Played("SKIN-1")
    port = UsbPort("usb:", backend)
    sent = bytes(range(256)) * 40
    backend.to_host += sent
    received = b""
    while len(received) < len(sent):
        received += port.read(1.0)
    assert received == sent
    assert {size % PACKET for size in backend.asked} == {0}
    port.write(sent[:1000])
    assert bytes(backend.to_device) == sent[:1000]


def test_silence_is_no_error_and_can_be_cancelled():
    port = UsbPort("usb:", Played("SKIN-1"))
    assert port.read(0.05) == b""
    threading.Timer(0.05, port.cancel).start()
    assert port.read() == b""
    port.cancel()
    assert port.read(10.0) == b""


def test_a_stall_is_cleared_and_the_stream_goes_on():
    backend = Played("SKIN-1")
    port = UsbPort("usb:", backend)
    backend.to_host += b"after"
    backend.fails = [errno.EPIPE]
    assert port.read(1.0) == b"after"
    assert backend.halts == 1


def test_a_name_says_which_kind_of_line_it_is(monkeypatch):
    monkeypatch.setattr(usb_port, "UsbPort", lambda port: ("usb", port))
    monkeypatch.setattr(ports, "SerialPort", lambda port, baud: ("serial", port, baud))
    assert ports.open_line("usb:SKIN-1") == ("usb", "usb:SKIN-1")
    assert ports.open_line("/dev/ttyACM0", 115_200) == ("serial", "/dev/ttyACM0", 115_200)


def test_the_udev_rule_names_the_ids_that_are_looked_for():
    rule = (Path(usb_port.__file__).parent / "60-eitskin.rules").read_text()
    ours = f'ATTR{{idVendor}}=="{VENDOR_ID:04x}", ATTR{{idProduct}}=="{PRODUCT_ID:04x}"'
    assert f'{ours}, ENV{{ID_MM_DEVICE_IGNORE}}="1"' in rule
    assert "60-eitskin.rules /etc/udev/rules.d/" in usb_port.RULE


@pytest.mark.parametrize("number", [errno.ENODEV, errno.EIO])
def test_an_unplugged_device_is_a_lost_port(number):
    backend = Played("SKIN-1")
    port = UsbPort("usb:", backend)
    for action in (lambda: port.read(1.0), lambda: port.write(b"x")):
        backend.fails = [number]
        with pytest.raises(PortLost, match="usb: vanished"):
            action()


def test_without_libusb_the_error_says_what_to_install(monkeypatch):
    def no_backend(**_):
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb_port.usb.core, "find", no_backend)
    with pytest.raises(TransportError, match=r"apt-get install libusb-1\.0-0"):
        UsbPort()
