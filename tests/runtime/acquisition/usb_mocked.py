"""The USB transport on a real libusb, with a mocked bus below it; ``test_usb_mocked.py`` runs this under umockdev.

One bus for all: libusb looks for the kernel's messages once a process.
"""

import contextlib
import errno
import os
import subprocess
import sys
import threading
import time

import pytest
import usb.core
from tests.faults.usb_bus import PACKET
from tests.faults.usb_skin import MockedUsb

from eitskin.acquisition import usb_port
from eitskin.acquisition.device import Device
from eitskin.acquisition.hotplug import HotPlug
from eitskin.acquisition.usb_port import PRODUCT_ID, VENDOR_ID, UsbPort
from eitskin.errors import PortBusy, PortLost, PortMissing, PortReturned
from eitskin_proto.wire import messages
from eitskin_proto.wire.codes import MessageType
from eitskin_proto.wire.frames import FrameView, StreamCounter
from eitskin_proto.wire.framing import encode

pytestmark = pytest.mark.process

PORT = "usb:USB-7"


@pytest.fixture(scope="module")
def bus():
    with MockedUsb("USB-7", rate_hz=250.0) as made:
        os.environ["UMOCKDEV_DIR"] = made.bus["UMOCKDEV_DIR"]
        yield made


@pytest.fixture
def port(bus):
    opened = UsbPort(PORT)
    try:
        yield opened
    finally:
        with contextlib.suppress(PortLost):
            opened.write(b"\0" + encode(messages.Stop().pack()))
        opened.close()


def frames_until(device, counter, enough, timeout_s=120.0, view=None):
    """Follow a stream until a number of frames has come; return how many."""
    view, frames, end_s = view or FrameView(), 0, time.perf_counter() + timeout_s
    while frames < enough and time.perf_counter() < end_s:
        for payload in device.payloads(1.0):
            if payload[0] == MessageType.FRAME:
                view.load(payload)
                counter.step(view.sequence, view.device_us)
                frames += 1
    return frames


def test_the_device_is_found_by_its_ids_and_serial_number(bus):
    [found] = usb_port.devices()
    assert (found.serial_number, found.port, found.usable) == ("USB-7", PORT, True)
    assert found.node.startswith("/dev/bus/usb/001/")
    with pytest.raises(PortMissing, match="no USB device 1209:0001 with serial number USB-8"):
        UsbPort("usb:USB-8")
    UsbPort("usb:").close()


def test_a_thousand_frames_arrive_whole_and_in_order(port):
    device, counter = Device(port), StreamCounter()
    assert device.hello.serial_number == "USB-7"
    device.start()
    view = FrameView()
    assert frames_until(device, counter, 1000, view=view) >= 1000
    assert (counter.resets, device.deframer.corrupt) == (0, 0)
    # The bus loses nothing: what is missing is what a busy machine's device could not send, by its own count.
    assert counter.lost == view.device_dropped


def test_silence_is_a_timeout_and_no_error_and_costs_nothing_later(port):
    while port.read(0.2):
        pass
    for _ in range(5):
        started_s = time.perf_counter()
        assert port.read(0.05) == b""
        assert time.perf_counter() - started_s >= 0.045
    assert Device(port).hello.serial_number == "USB-7"


def test_a_read_can_be_cancelled(port):
    while port.read(0.2):
        pass
    threading.Timer(0.1, port.cancel).start()
    assert port.read() == b""


def test_a_second_program_is_told_that_the_device_is_in_use(bus, port):
    code = f"from eitskin.acquisition.usb_port import UsbPort; UsbPort({PORT!r})"
    done = subprocess.run(
        [sys.executable, "-c", code], env=bus.environment, capture_output=True, text=True, check=False
    )
    assert PortBusy.__name__ in done.stderr, done.stderr
    assert Device(port).hello.serial_number == "USB-7", "the first one is not disturbed"


def test_a_stalled_endpoint_is_cleared_and_the_stream_goes_on_with_the_loss_counted(bus, port):
    device, counter = Device(port), StreamCounter()
    device.start()
    frames_until(device, counter, 20)
    for stalls in range(1, 4):
        bus.tell("stall")
        assert frames_until(device, counter, 40) >= 40
        for _ in range(1000):  # a busy machine's bus may come to it late
            if counter.lost >= stalls:
                break
            frames_until(device, counter, 10)
    assert counter.resets == 0
    assert counter.lost >= 3, "the packet at which it stalled"
    assert device.deframer.corrupt <= 3, "at most one packet cut by each stall"


def test_a_read_of_no_whole_number_of_packets_overflows_which_is_why_none_is_asked_for(bus):
    handle = usb.core.find(idVendor=VENDOR_ID, idProduct=PRODUCT_ID)
    handle.set_configuration()
    end_in, end_out = 0x81, 0x01
    with pytest.raises(usb.core.USBError) as raised:  # noqa: PT012 -- asking until enough waits there is the test
        for _ in range(100):
            handle.write(end_out, b"\0" + encode(messages.HelloRequest().pack()) * 3)
            handle.read(end_in, PACKET + 36, 60_000)
    assert raised.value.errno == errno.EOVERFLOW
    handle.read(end_in, 64 * PACKET)
    usb.util.dispose_resources(handle)


def test_an_unplugged_device_is_a_lost_port_and_comes_back_under_another_number(bus):
    opened, node = UsbPort(PORT), usb_port.devices()[0].node
    Device(opened).start()  # the plug is pulled at a scan
    bus.tell("unplug 0.3")
    with pytest.raises(PortLost, match="usb:USB-7 vanished"):  # noqa: PT012 -- reading until it happens is the test
        for _ in range(100):
            opened.read(1.0)
    with pytest.raises(PortLost):
        opened.write(b"x")
    opened.close()
    with pytest.raises(PortMissing):
        UsbPort(PORT)
    deadline_s = time.perf_counter() + 60.0
    listed = usb_port.devices()
    while [found.node for found in listed] in ([], [node]) and time.perf_counter() < deadline_s:
        time.sleep(0.02)  # libusb lists the old number until it has read the kernel's message
        listed = usb_port.devices()
    [back] = listed
    assert (back.serial_number, back.node == node) == ("USB-7", False)


def test_the_stream_resumes_after_each_unplug_and_nothing_is_left_open(bus):
    UsbPort(PORT).close()
    before = len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))
    line, counter = HotPlug(PORT, give_up_s=30.0), StreamCounter()
    device = Device(line)
    device.start()
    for cycle in range(1, 5):
        frames_until(device, counter, 10)
        bus.tell("unplug 0.05")
        with pytest.raises(PortReturned):
            frames_until(device, counter, 10_000)
        device.recover()
        assert line.returns == cycle
        assert frames_until(device, counter, 10) >= 10
    assert counter.resets == 0, "the device went on scanning"
    assert counter.lost >= 4 * 8, "0.05 s at 250 frames/s is missing each time, and counted"
    device.stop()
    line.close()
    assert (len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))) == before
