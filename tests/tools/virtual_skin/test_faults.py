"""Scripted faults on a real pseudo-terminal: what they do to the bytes, and that they do it when they were told to."""

import select
import time
from contextlib import contextmanager

import numpy as np
import pytest
import serial

from eitskin_proto.wire import messages as m
from eitskin_proto.wire.codes import FrameFlag
from eitskin_proto.wire.frames import StreamCounter
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_tools.virtual_skin.device import VirtualDevice
from eitskin_tools.virtual_skin.faults import FaultPlayer, parse
from eitskin_tools.virtual_skin.process import configuration_for
from eitskin_tools.virtual_skin.pty import PtyPort
from eitskin_tools.virtual_skin.server import SkinServer

from ..conftest import ROWS_V, Ramp

RATE_HZ = 500.0

PATIENCE_S = 60.0
"""How long bytes may take through a pseudo-terminal."""


class Line(PtyPort):
    """A pseudo-terminal that counts what the device put on it."""

    written = 0

    def write(self, data):
        taken = super().write(data)
        self.written += len(data) if taken else 0
        return taken

    def write_all(self, data, timeout_s):
        taken = super().write_all(data, timeout_s)
        self.written += len(data) if taken else 0
        return taken


class Skin:
    """A virtual skin whose clock only the test moves, and what a host sees of it.

    Args:
        faults: As of the command line.
        port: Its line.
    """

    def __init__(self, faults, port):
        self.now_ns = 1_000_000_000
        device = VirtualDevice(Ramp(), configuration_for(RATE_HZ), self.now_ns)
        player = FaultPlayer([parse(text) for text in faults], seed=1)
        self.server, self.port = SkinServer(device, port, player, clock=lambda: self.now_ns), port
        self.deframer = Deframer()
        self.frames = []
        self.others = []
        self.events = []
        self.open()

    def open(self):
        self.serial = serial.Serial(str(self.port.path), timeout=0.05, exclusive=True)
        self.taken = self.port.written

    def tell(self, request):
        self.serial.write(b"\0" + encode(request.pack()))
        assert select.select([self.port.fileno()], [], [], PATIENCE_S)[0]
        self.server.turn(self.now_ns)

    def listen(self, seconds):
        """Let time pass, and take everything that the device sends meanwhile."""
        self.sleep(seconds, self.take)

    def sleep(self, seconds, after_each_turn=lambda: None):
        """Let time pass, from one thing that the device has to do to the next."""
        until_ns = self.now_ns + int(seconds * 1e9)
        while self.now_ns < until_ns:
            due_ns = self.server.next_ns() or until_ns
            self.now_ns = min(max(self.now_ns + 1, due_ns), until_ns)
            self.server.turn(self.now_ns)
            after_each_turn()

    def take(self):
        """Read until everything has come that is on the line, or the plug is out; the kernel takes its time."""
        end_s = time.monotonic() + PATIENCE_S
        while self.taken < self.port.written or not self.port.plugged:
            assert time.monotonic() < end_s, f"{self.port.written - self.taken} bytes have not come"
            self.port.flush()
            data = self.serial.read(max(1, self.serial.in_waiting))
            self.taken += len(data)
            for payload in self.deframer.feed(data):
                message = m.unpack(payload)
                kind = {m.Frame: self.frames, m.Event: self.events}.get(type(message), self.others)
                kind.append(message)

    @property
    def sequences(self):
        return [frame.sequence for frame in self.frames]


@contextmanager
def skin(*faults):
    with Line() as port:
        host = Skin(faults, port)
        try:
            yield host
        finally:
            host.serial.close()


def test_a_clean_stream_has_every_frame_and_no_other_byte():
    with skin() as host:
        host.tell(m.Start(1, frames=100))
        host.listen(0.6)
        assert host.sequences == list(range(100))
        assert (host.deframer.corrupt, host.deframer.discarded_bytes) == (0, 0)
        steps = np.diff([frame.device_us for frame in host.frames])
        assert set(steps.tolist()) == {2000}, "deadlines are absolute: device time does not drift with the load"


@pytest.mark.parametrize("fault", ["flip@0.1/0.05:1", "drop@0.1/0.05:10", "garbage@0.1/0.05:50"])
def test_damaged_packets_are_lost_one_by_one_and_nothing_is_shifted(fault):
    with skin(fault) as host:
        host.tell(m.Start(1, frames=150))
        host.listen(0.7)
        injected = len(host.server.player.injected)
        assert injected >= 4
        counter = StreamCounter()
        for frame in host.frames:
            counter.step(frame.sequence, frame.device_us)
            # the ramp's rows are in a fixed ratio: a shifted sample would break it
            assert frame.counts[0] / frame.counts[50] == pytest.approx(ROWS_V[0] / ROWS_V[50], rel=1e-3)
        assert 1 <= counter.lost <= 2 * injected  # a flipped delimiter takes its neighbour along
        assert host.deframer.corrupt >= injected // 2


def test_a_stall_is_a_gap_in_time_and_not_in_sequence():
    with skin("stall@0.1:0.3") as host:
        host.tell(m.Start(1, frames=100))
        host.listen(0.9)
        assert host.sequences == list(range(100))
        assert np.diff([frame.device_us for frame in host.frames]).max() >= 300_000


def test_a_reset_cuts_a_packet_and_starts_clock_and_sequence_anew():
    with skin("reset@0.1") as host:
        host.tell(m.Start(1))
        host.listen(0.3)
        last = host.frames[-1]
        assert host.server.device.boots == 2
        host.tell(m.Start(2, frames=10))
        host.listen(0.2)
        assert host.sequences[-10:] == list(range(10))
        assert host.frames[-10].flags & FrameFlag.FIRST
        assert last.sequence > 10
        assert host.deframer.corrupt == 1, "the packet that was cut"


def test_an_unplugged_port_vanishes_and_returns_under_its_name():
    with skin("unplug@0.1:0.2") as host:
        host.tell(m.Start(1))
        with pytest.raises((serial.SerialException, OSError)):
            host.listen(0.5)
        host.serial.close()
        assert not host.port.path.exists()
        host.sleep(0.21)
        assert host.port.path.exists()
        before = host.sequences[-1]
        host.open()
        host.deframer.reset()
        host.listen(0.2)
        assert host.sequences[-1] > before + 50, "the device went on scanning: the gap can be counted"


def test_a_host_that_does_not_read_makes_the_device_count_what_it_drops():
    with skin() as host:
        host.tell(m.Start(1))
        host.sleep(0.5)  # 250 frames of 352 bytes against 18 KiB
        host.listen(0.1)
        assert host.port.overruns > 0
        assert host.frames[-1].device_dropped == pytest.approx(host.port.overruns, abs=2)
        assert host.deframer.corrupt == 0, "packets are dropped whole"
        assert host.sequences[-1] + 1 - len(host.sequences) == host.frames[-1].device_dropped


def test_answers_may_fail_to_come_come_twice_or_late():
    with skin("mute@0:5") as host:
        host.tell(m.HelloRequest(1))
        host.listen(0.15)
        assert host.others == []
    with skin("twice@0:5") as host:
        host.tell(m.HelloRequest(1))
        host.listen(0.15)
        assert [hello.tag for hello in host.others] == [1, 1]
    with skin("late@0:0.3") as host:
        host.tell(m.TimeRequest(1))
        host.listen(0.15)
        assert host.others == []
        host.listen(0.4)
        assert len(host.others) == 1


@pytest.mark.parametrize("kind", ["frozen", "stuck", "failing"])
def test_a_front_end_may_hang_for_a_while(kind):
    with skin(f"{kind}@0.1:0.2") as host:
        host.tell(m.Start(1, frames=200))
        host.listen(0.8)
        counts = [tuple(frame.counts.tolist()) for frame in host.frames]
        failed = [event for event in host.events if event.text == "FRONT_END_FAILED"]
        assert len(failed) == pytest.approx(100, abs=3) if kind == "failing" else not failed
        assert len(counts) == 200
        assert host.sequences[-1] + 1 == 200 + len(failed)
        one = max(counts.count(frame) for frame in set(counts))
        assert one == (1 if kind == "failing" else pytest.approx(100, abs=3))
        assert (len(set(counts[60])) == 1) == (kind == "stuck")
        assert counts[-1] != counts[-2], "it is over"
        assert [injected.kind for injected in host.server.player.injected] == [kind]
