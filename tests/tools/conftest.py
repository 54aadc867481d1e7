import itertools

import numpy as np
import pytest

from eitskin_proto.wire import messages
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_tools.virtual_skin.device import Identity, VirtualDevice
from eitskin_tools.virtual_skin.process import configuration_for

ROWS_V = np.linspace(-0.1, -0.001, 104)


class Ramp:
    """A source whose voltages say what time they were asked for."""

    def voltages(self, time_s):
        return ROWS_V * (1.0 + time_s)


class Host:
    """The host's end of a virtual device without any line: requests in, messages out, time as an argument."""

    def __init__(self, device):
        self.device = device
        self.now_ns = 1_000_000_000
        self.deframer = Deframer()
        self.tags = itertools.cycle(range(1, 256))

    def ask(self, request):
        (answer,) = self.send(encode(request.pack()))
        return answer

    def send(self, data):
        packets = self.device.receive(b"\0" + data, self.now_ns)
        return [messages.unpack(payload) for packet in packets for payload in self.deframer.feed(packet)]

    def sweep(self, advance_ns=5000000):
        self.now_ns += advance_ns
        (payload,) = self.deframer.feed(self.device.sweep(self.now_ns))
        return messages.unpack(payload)


@pytest.fixture
def host():
    return Host(VirtualDevice(Ramp(), configuration_for(200.0), 1_000_000_000, Identity()))
