from dataclasses import replace

import pytest

from eitskin.acquisition import device as devices
from eitskin.acquisition.device import Device, check_usable
from eitskin.acquisition.serial_port import SerialPort
from eitskin.errors import HandshakeError, MismatchError, NotReady
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.wire.codes import MessageType
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_proto.wire.messages import Ack, Time


class Line:
    """A transport whose other side is a function of what was written."""

    name = "test line"
    line_bytes_per_s = 0

    def __init__(self, answer):
        self.answer, self.inbox, self.written = answer, [], []

    def write(self, data):
        self.written.append(data)
        self.inbox += self.answer(data)

    def read(self, timeout_s=None):
        return self.inbox.pop(0) if self.inbox else b""

    def cancel(self):
        pass

    def report(self):
        return []

    def close(self):
        pass


@pytest.fixture
def hasty(monkeypatch):
    monkeypatch.setattr(devices, "HANDSHAKE_S", 0.2)


def test_a_device_introduces_itself_and_streams(virtual_skin):
    with virtual_skin(rate_hz=100.0) as port:
        line = SerialPort(port)
        device = Device(line)
        assert device.hello.serial_number == "VIRTUAL-0001"
        assert device.configuration.startswith("paper/")
        device.start()
        frames = []
        while len(frames) < 5:
            frames += device.payloads(1.0)
        assert device.deframer.corrupt == 0
        device.stop()
        line.close()


def test_a_device_of_another_protocol_is_refused_with_found_expected_and_fix(virtual_skin):
    with virtual_skin(faults=["foreign"]) as port:
        line = SerialPort(port)
        with pytest.raises(
            MismatchError, match=rf"protocol_id: found 00000000f0e1d2c3, expected {PROTOCOL_ID}; .*flash"
        ):
            Device(line)
        line.close()


def test_silence_is_named(hasty):
    with pytest.raises(HandshakeError, match=r"did not answer within 0\.2 s"):
        Device(Line(lambda _: []))


def test_a_device_that_talks_nonsense_is_told_from_a_silent_one(hasty):
    with pytest.raises(HandshakeError, match=r"sends \d+ bytes that do not belong.*baud"):
        Device(Line(lambda _: [b"T: 23.5 C\r\n" * 3, b"\0more\0"]))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"rows": 39, "drives": 0x0007}, r"39 rows of drives 0x0007, expected 104 or 208"),
        ({"volts_per_count": 0.0}, r"found 0 V, expected more than 0"),
        ({"volts_per_count": -1e-9}, r"expected more than 0"),
        ({"volts_per_count": 1e300}, r"at most 1000 V"),
        ({"sample_bytes": 5}, r"found 5, expected 2, 3 or 4"),
        (
            {"line_bytes_per_s": 11520},
            r"200 frames/s of 456 bytes do not fit a line of 11520 bytes/s, which carries 25",
        ),
    ],
)
def test_a_device_whose_frames_cannot_be_used_is_refused(hello, change, text):
    with pytest.raises(HandshakeError, match=text):
        check_usable(replace(hello, **change), 0)


def test_a_slow_line_of_ours_refuses_the_rate_and_says_the_largest(hello):
    with pytest.raises(HandshakeError, match="raise --baud"):
        check_usable(hello, 11520)
    check_usable(hello, 200_000)


class Changing(Line):
    """A device that says one thing first and another later, and acknowledges everything."""

    def __init__(self, *hellos):
        self.hellos = list(hellos)
        super().__init__(self.say)

    def say(self, data):
        answers = []
        for payload in Deframer().feed(data):
            if payload[0] == MessageType.HELLO_REQUEST:
                answers.append(encode((self.hellos.pop(0) if len(self.hellos) > 1 else self.hellos[0]).pack()))
            elif payload[0] == MessageType.TIME_REQUEST:
                answers.append(encode(Time(0, payload[1]).pack()))
            else:
                answers.append(encode(Ack(payload[0], tag=payload[1]).pack()))
        return answers


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"volts_per_count": -1e-9}, "found -1e-09 V, expected more than 0"),
        ({"volts_per_count": 2e-9}, "volts_per_count is now 2e-09, expected 1e-09.*eitskin reference"),
        ({"rate_mHz": 0}, r"HELLO\.rate_mHz: found 0, expected 100 to 100000000"),
        ({"rate_mHz": 99}, r"0\.1 to 100000 frames/s"),
        ({"rows": 208}, r"HELLO\.rows: found 208, but its flags mean 104"),
        ({"sample_bytes": 3}, "sample_bytes is now 3, expected 4"),
        ({"serial_number": "OTHER"}, "is now OTHER, expected TEST-1"),
        ({"configuration_digest": 1}, "configuration is now paper/00000001"),
    ],
)
def test_every_hello_is_judged_like_the_first(hello, change, text):
    device = Device(Changing(hello, replace(hello, **change)))
    with pytest.raises(HandshakeError, match=text):
        device.recover()
    assert device.hello == hello


def test_who_leaves_waits_for_no_answer(hello):
    line = Changing(hello)
    device = Device(line)
    line.answer = lambda _: []  # from now on the device hears nothing
    device.stopping = True
    for wait in (device.start, device.stop, device.recover):
        with pytest.raises(NotReady):
            wait()
    line.written.clear()
    with pytest.raises(NotReady, match=r"did not acknowledge STOP within 0\.2 s"):
        device.leave()
    assert len(line.written) == 1
    line.gone = True
    device.leave()  # nobody waits for a port that is gone
    assert len(line.written) == 1
