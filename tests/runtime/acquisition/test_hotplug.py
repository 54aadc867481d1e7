"""A port that vanishes and returns: the stream resumes, what was lost is counted, another device is refused."""

import threading
import time
from dataclasses import replace
from itertools import pairwise

import pytest

from eitskin.acquisition.device import Device
from eitskin.acquisition.hotplug import HotPlug, port_named, usb_name
from eitskin.acquisition.serial_port import SerialPort
from eitskin.errors import HandshakeError, PortLost, PortReturned, TransportError
from eitskin.skin import Skin
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_proto.wire.messages import Hello
from eitskin_tools.virtual_skin.pty import PtyPort

HELLO = Hello(
    firmware_version=(1, 0, 0), hardware_id=1, serial_number="SLOW-1", configuration_digest=1, generation=1,
    configuration_name="slow", rate_mHz=100_000, rows=104, sample_bytes=4, volts_per_count=1e-9,
)  # fmt: skip


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


def test_a_port_that_is_missing_or_held_at_first_is_waited_for(pty):
    pty.unplug()
    line = HotPlug(str(pty.path), give_up_s=60.0)
    assert line.gone
    assert line.trouble.startswith(f"no port {pty.path}")
    pty.plug()
    other = SerialPort(str(pty.path))
    with pytest.raises(PortLost, match=r"waited 0\.1 s: .* open in another program"):
        HotPlug(str(pty.path), give_up_s=0.1).read()
    other.close()
    with pytest.raises(PortReturned):
        line.write(b"hello")
    line.close()
    with pytest.raises(TransportError, match="no driver is called 'nobody'"):  # which no wait makes better
        HotPlug("nobody:/dev/x")


def test_a_driver_that_waits_for_its_device_is_left_and_its_line_is_closed(pty):
    opens, comes, closed = threading.Event(), threading.Event(), threading.Event()

    class Line(SerialPort):
        def close(self):
            super().close()
            closed.set()

    def open_line(port, baud):
        opens.set()
        assert comes.wait(60.0)
        return Line(str(pty.path), baud)

    comes.set()
    line = HotPlug(f"line:{pty.path}", open_line=open_line)
    comes.clear(), opens.clear(), pty.unplug(), pty.plug()

    def cancel():
        assert opens.wait(60.0)
        line.cancel()

    stopper = threading.Thread(target=cancel)
    stopper.start()
    assert line.read() == b""
    assert line.gone
    stopper.join()
    closed.clear()
    comes.set()
    assert closed.wait(60.0)
    line.close()


def test_a_board_that_boots_and_prints_is_asked_again(pty):
    """The board answers only once it has heard several requests, and prints text for each of them before."""
    known, asked, texts = threading.Event(), Deframer(), [b"booting 2.1\r\n"] * 3

    def boot():
        while not known.wait(0.01):
            for request in asked.feed(pty.read()):
                pty.write(texts.pop() if texts else encode(replace(HELLO, tag=request[1]).pack()))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("eitskin.acquisition.device.HANDSHAKE_S", 0.2)
        board = threading.Thread(target=boot)
        board.start()
        line = HotPlug(str(pty.path), give_up_s=60.0)
        assert Device(line).hello.serial_number == HELLO.serial_number
    known.set()
    board.join()
    assert line.returns == 0  # opening the port again would have reset the board
    line.close()


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
    assert usb_name(f"line:{pty.path}?rate=50") == usb_name(str(pty.path)) == "1209:5315 SKIN-7"
    assert usb_name("/dev/ttyS0") == ""
    line = HotPlug(str(pty.path), give_up_s=60.0)
    try:
        with PtyPort() as elsewhere:
            pty.unplug()
            ports[1] = Found(str(elsewhere.path), 0x1209, 0x5315, "SKIN-7")
            with pytest.raises(PortReturned, match=str(elsewhere.path)):
                line.read(60.0)
            assert line.name == str(elsewhere.path)
            assert port_named("1209:5315 SKIN-8") is None
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
