"""A port that vanishes and returns: the stream resumes, what was lost is counted, another device is refused."""

import threading
import time
from itertools import pairwise

import pytest

from eitskin.acquisition.hotplug import HotPlug, UsbName, port_named, usb_name
from eitskin.errors import HandshakeError, PortLost, PortReturned
from eitskin.skin import Skin
from eitskin_tools.virtual_skin.pty import PtyPort


@pytest.fixture
def pty():
    with PtyPort() as port:
        yield port


def test_bytes_pass_until_the_plug_is_pulled_and_after_it_is_back(pty):
    line = HotPlug(str(pty.path), give_up_s=60.0)
    try:
        for cycle in range(1, 4):
            assert pty.write(b"before")
            assert line.read(60.0) == b"before"
            pty.unplug()
            threading.Timer(0.1, pty.plug).start()
            with pytest.raises(PortReturned, match="vanished and is back: repeat the handshake"):
                line.read(60.0)
            assert line.returns == cycle
            line.write(b"after")
            deadline = time.monotonic() + 60.0
            while (heard := pty.read()) == b"" and time.monotonic() < deadline:
                time.sleep(0.01)
            assert heard == b"after"
    finally:
        line.close()


def test_a_port_that_stays_away_is_given_up_with_its_name(pty):
    line = HotPlug(str(pty.path), give_up_s=0.15)
    try:
        pty.unplug()
        with pytest.raises(PortLost, match=rf"{pty.path} vanished and did not come back within 0\.15 s"):
            line.read()
        assert line.line_bytes_per_s == 0
    finally:
        line.close()
    line.close()  # closing twice is fine


def test_waiting_for_a_port_can_be_cancelled(pty):
    line = HotPlug(str(pty.path))
    try:
        pty.unplug()
        threading.Timer(0.1, line.cancel).start()
        started = time.monotonic()
        assert line.read() == b""
        assert time.monotonic() - started < 30.0
    finally:
        line.close()


class Found:
    def __init__(self, device, vid, pid, serial_number, location=None):
        self.device, self.vid, self.pid, self.serial_number = device, vid, pid, serial_number
        self.location = location


def test_a_usb_port_is_found_again_under_another_path(monkeypatch, pty):
    ports = [Found("/dev/ttyS0", None, None, None), Found(str(pty.path), 0x1209, 0x5315, "SKIN-7")]
    monkeypatch.setattr("eitskin.acquisition.ports.list_ports.comports", lambda: ports)
    assert usb_name(str(pty.path)) == UsbName(0x1209, 0x5315, "SKIN-7")
    assert usb_name("/dev/ttyS0") is None
    line = HotPlug(str(pty.path), give_up_s=60.0)
    try:
        with PtyPort() as elsewhere:
            pty.unplug()
            ports[1] = Found(str(elsewhere.path), 0x1209, 0x5315, "SKIN-7")
            with pytest.raises(PortReturned, match=str(elsewhere.path)):
                line.read(60.0)
            assert line.name == str(elsewhere.path)
            assert port_named(UsbName(0x1209, 0x5315, "SKIN-8")) is None
    finally:
        line.close()


def test_the_stream_resumes_after_an_unplug_with_the_gap_counted(virtual_skin, tiny):
    with virtual_skin(rate_hz=100.0, faults=["unplug@1.5:0.3"]) as port:
        line = HotPlug(port, give_up_s=60.0)
        with Skin(line, bundle=tiny) as skin:
            skin.capture_reference(20)
            sequences, events = [], []
            for frame in skin.frames(timeout_s=120.0):
                sequences.append(frame.sequence)
                events += frame.events
                if skin.recoveries and len(sequences) > 40 and sequences[-1] - sequences[-10] == 9:
                    break
            assert line.returns == 1
            assert skin.recoveries == 1
            assert "recovered" in events
            gaps = [b - a - 1 for a, b in pairwise(sequences)]
            assert max(gaps) >= 10, "0.3 s at 100 frames/s is missing"
            assert skin.status()["lost"] >= max(gaps)


class Swapped(HotPlug):
    """A line behind which another device turns up when it vanishes."""

    def __init__(self, port, other):
        super().__init__(port, give_up_s=60.0)
        self.other = other

    def _reopened(self):
        self.name = self.other
        return super()._reopened()


def test_another_device_on_the_returned_port_is_refused(virtual_skin, tiny):
    with (
        virtual_skin(faults=["unplug@1.0:60"]) as port,
        virtual_skin(serial_number="OTHER-2") as other,
        Skin(Swapped(port, other), bundle=tiny) as skin,
    ):
        skin.capture_reference(10)
        with pytest.raises(HandshakeError, match="the device is now OTHER-2, expected VIRTUAL-0001"):
            for _ in skin.frames(timeout_s=120.0):
                pass
