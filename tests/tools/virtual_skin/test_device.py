"""The virtual skin's state machine, against SPEC.md: it must speak the wire as the firmware does."""

import numpy as np
import pytest

from eitskin_proto.wire import messages as m
from eitskin_proto.wire.codes import Code, FrameFlag, HelloFlag, Mode
from eitskin_proto.wire.framing import encode
from eitskin_proto.wire.scan_rows import row_count, table_rows
from eitskin_tools.virtual_skin.device import VirtualDevice
from eitskin_tools.virtual_skin.process import configuration_for

from ..conftest import ROWS_V, Host, Ramp


def test_hello_repeats_the_tag_and_names_a_device_of_this_installation(host):
    hello = host.ask(m.HelloRequest(7))
    assert isinstance(hello, m.Hello)
    hello.check()
    assert (hello.tag, hello.rows, hello.rate_mHz, hello.sample_bytes) == (7, 104, 200_000, 3)
    assert hello.flags == HelloFlag.FACTORY


def test_frames_carry_the_voltages_to_half_a_count(host):
    hello = host.ask(m.HelloRequest(1))
    assert host.ask(m.Start(2)) == m.Ack(request=2, code=Code.OK, detail=0, tag=2)
    frame = host.sweep()
    expected = ROWS_V * 1.005  # the script's time counts from START: 5 ms
    assert np.abs(frame.counts * hello.volts_per_count - expected).max() <= 0.5001 * hello.volts_per_count
    assert frame.saturation == 0
    assert frame.flags == FrameFlag.FIRST
    assert host.sweep().flags == 0


def test_sequence_counts_scans_and_stop_keeps_it(host):
    host.ask(m.Start(1))
    assert [host.sweep().sequence for _ in range(3)] == [0, 1, 2]
    host.ask(m.Stop(2))
    assert not host.device.streaming
    host.ask(m.Start(3))
    assert host.sweep().sequence == 3


def test_a_reset_starts_clock_and_sequence_anew_but_not_the_world(host):
    host.ask(m.Start(1))
    host.sweep()
    host.device.boot(host.now_ns)
    assert not host.device.streaming
    host.ask(m.Start(2))
    frame = host.sweep()
    assert (frame.sequence, frame.device_us) == (0, 5_000)
    hello = host.ask(m.HelloRequest(3))
    assert np.allclose(frame.counts * hello.volts_per_count, ROWS_V * 1.010, atol=hello.volts_per_count)


def test_rows_beyond_full_scale_are_cut_off_and_marked(host):
    host.ask(m.Start(1))
    (payload,) = host.deframer.feed(host.device.sweep(host.now_ns, overdriven_rows=3))
    frame = m.unpack(payload)
    assert frame.saturation == 0b111
    assert (frame.counts[:3] == (1 << 23) - 1).all()


@pytest.mark.parametrize("name", ["paper", "full208"])
def test_the_full_table_carries_every_row_and_its_reciprocal(name):
    host = Host(VirtualDevice(Ramp(), configuration_for(100.0, name), 1_000_000_000))
    hello = host.ask(m.HelloRequest(1))
    host.ask(m.Start(2))
    frame = host.sweep()
    rows = table_rows(hello.full, hello.drives)
    assert hello.rows == len(rows) == len(frame.counts)
    assert np.allclose(frame.counts * hello.volts_per_count, (ROWS_V * 1.005)[rows], atol=hello.volts_per_count)


def test_idle_mode_scans_the_subset_at_its_own_rate(host):
    before = host.ask(m.HelloRequest(1))
    assert host.ask(m.SetMode(2, Mode.IDLE)).code == Code.OK
    idle = host.ask(m.HelloRequest(3))
    assert idle.flags & HelloFlag.IDLE
    assert (idle.rate_mHz, idle.rows) == (before.rate_mHz, 104), "they are the active mode's"
    assert host.device.rate_mHz == host.device.store.configuration.idle_rate_mHz < before.rate_mHz
    host.ask(m.Start(4))
    frame = host.sweep()
    assert frame.flags & FrameFlag.IDLE
    assert len(frame.counts) == row_count(False, before.idle_drives) < 104
    assert host.ask(m.SetMode(5, 9)).code == Code.BAD_VALUE


def test_doubtful_requests_are_answered_by_the_code_that_says_why(host):
    assert host.send(encode(b"\x7f\x05"))[0] == m.Ack(request=0x7F, code=Code.UNKNOWN_TYPE, detail=2, tag=5)
    assert host.send(encode(m.Start(6).pack() + b"\0"))[0].code == Code.BAD_LENGTH
    assert host.send(encode(m.HelloRequest(6).pack().replace(b"EITS", b"NOPE")))[0].code == Code.BAD_VALUE
    damaged = bytearray(encode(m.Start(7).pack()))
    damaged[2] ^= 0x10
    assert host.send(bytes(damaged)) == []
    assert not host.device.streaming


def test_a_rate_that_the_electronics_cannot_reach_is_refused_with_the_largest():
    assert configuration_for(1000.0).rate_hz == 1000.0
    with pytest.raises(ValueError, match=r"2272 Hz"):
        configuration_for(5000.0)
