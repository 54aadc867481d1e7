"""The virtual skin's state machine, against SPEC.md: it must speak the wire as the firmware does."""

import numpy as np
import pytest

from eitskin_proto.wire import messages as m
from eitskin_proto.wire.codes import Code, FrameFlag
from eitskin_proto.wire.scan_rows import table_rows
from eitskin_tools.virtual_skin.device import VirtualDevice
from eitskin_tools.virtual_skin.process import configuration_for

from ..conftest import ROWS_V, Host, Ramp


def test_frames_carry_the_voltages_to_half_a_count(host):
    hello = host.ask(m.HelloRequest(1))
    assert host.ask(m.Start(2)) == m.Ack(request=2, code=Code.OK, detail=0, tag=2)
    frame = host.sweep()
    expected = ROWS_V * 1.005  # the script's time counts from START: 5 ms
    assert np.abs(frame.counts * hello.volts_per_count - expected).max() <= 0.5001 * hello.volts_per_count
    assert frame.saturation == 0
    assert frame.flags == FrameFlag.FIRST
    assert host.sweep().flags == 0


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


def test_a_rate_that_the_electronics_cannot_reach_is_refused_with_the_largest():
    assert configuration_for(1000.0).rate_hz == 1000.0
    with pytest.raises(ValueError, match=r"2272 Hz"):
        configuration_for(5000.0)
