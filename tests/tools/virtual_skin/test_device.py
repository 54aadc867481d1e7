"""What the virtual skin's scans carry; how it speaks the wire is tested beside the firmware's core (tests/firmware)."""

import numpy as np
import pytest

from eitskin_proto.wire import messages as m
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_proto.wire.scan_rows import table_rows
from eitskin_tools.virtual_skin.device import VirtualDevice
from eitskin_tools.virtual_skin.process import configuration_for

from ..conftest import ROWS_V, Ramp


def scanned(name, **more):
    """Return HELLO of a virtual skin with a configuration, and its first frame, 5 ms after START."""
    begin_ns, deframer = 1_000_000_000, Deframer()
    device = VirtualDevice(Ramp(), configuration_for(100.0, name), begin_ns)
    packets = device.receive(b"\0" + encode(m.HelloRequest(1).pack()) + encode(m.Start(2).pack()), begin_ns)
    hello, _ = (m.unpack(payload) for packet in packets for payload in deframer.feed(packet))
    (payload,) = deframer.feed(device.sweep(begin_ns + 5_000_000, **more))
    return hello, m.unpack(payload)


def test_rows_beyond_full_scale_are_cut_off_and_marked():
    _, frame = scanned("paper", overdriven_rows=3)
    assert frame.saturation == 0b111
    assert (frame.counts[:3] == (1 << 23) - 1).all()


@pytest.mark.parametrize("name", ["paper", "full208"])
def test_the_full_table_carries_every_row_and_its_reciprocal(name):
    hello, frame = scanned(name)
    rows = table_rows(hello.full, hello.drives)
    assert hello.rows == len(rows) == len(frame.counts)
    assert np.allclose(frame.counts * hello.volts_per_count, (ROWS_V * 1.005)[rows], atol=hello.volts_per_count)
