"""A virtual skin in this process, and lines to it that vanish at an operation that a test names."""

import time

import numpy as np

from eitskin.errors import PortLost
from eitskin_proto.sensor.table import N_ROWS
from eitskin_tools.virtual_skin.device import Identity, VirtualDevice
from eitskin_tools.virtual_skin.process import configuration_for

ROWS_V = np.linspace(-0.1, -0.001, N_ROWS)


class Noisy:
    """Voltages with noise: a reference whose frames repeat each other bit by bit is refused."""

    def __init__(self):
        self.rng = np.random.default_rng(0)
        self.factor = 1.0

    def voltages(self, _):
        return self.factor * ROWS_V * (1.0 + 1e-4 * self.rng.standard_normal(N_ROWS))


class Skin:
    """The device; lines to it come and go."""

    def __init__(self, rate_hz=200.0):
        self.source = Noisy()
        self.device = VirtualDevice(self.source, configuration_for(rate_hz), time.perf_counter_ns(), Identity("HERE-1"))
        self.operations = 0
        self.leaves = lambda kind, number: False
        """Whether the line vanishes at a read or a write, of a number from 1."""
        self._sent, self._due_ns = bytearray(), 0

    def taken(self):
        """Return what the device has sent by now."""
        device, now_ns = self.device, time.perf_counter_ns()
        if device.next_ns and now_ns >= device.next_ns:
            for packet in device.poll(now_ns):
                self._sent += packet
        if not device.streaming:
            self._due_ns = 0
        else:
            self._due_ns = self._due_ns or now_ns + device.scan_ns
            while self._due_ns <= now_ns:
                self._sent += device.sweep(int(self._due_ns))
                self._due_ns += int(device.period_ns)
        sent, self._sent = bytes(self._sent), bytearray()
        return sent

    def line(self, path="/dev/here", baud=0):
        return Line(self)


class Line:
    """One line to it, which stays dead once it has vanished."""

    line_bytes_per_s, name = 0, "/dev/here"

    def __init__(self, skin):
        self._skin, self._dead, self._cancelled = skin, False, False

    def _operate(self, kind):
        self._skin.operations += 1
        self._dead = self._dead or self._skin.leaves(kind, self._skin.operations)
        if self._dead:
            raise PortLost(f"gone at operation {self._skin.operations}, a {kind}")

    def read(self, timeout_s=None):
        self._operate("read")
        end_s = None if timeout_s is None else time.perf_counter() + timeout_s
        while not self._cancelled:
            if sent := self._skin.taken():
                return sent
            if end_s is not None and time.perf_counter() >= end_s:
                return b""
            time.sleep(0.0005)
        self._cancelled = False
        return b""

    def write(self, data):
        self._operate("write")
        for packet in self._skin.device.receive(data, time.perf_counter_ns()):
            self._skin._sent += packet

    def cancel(self):
        self._cancelled = True

    def report(self):
        return []

    def close(self):
        pass
