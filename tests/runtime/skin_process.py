"""A virtual skin for the runtime's tests: the real state machine, pty and faults, with made-up voltages instead of
physics.

Takes one JSON object as its argument, prints the port's path and the process's number, and serves until it is
terminated. Without an argument it makes a skin of each line that it reads, in a process of its own, which is there at
once: all is imported already. ``wire`` names a file that
is made: of the last ``WIRE_FRAMES`` sequence numbers, when each frame was on the line. With ``touches_wait`` the
touches' clock starts when a file called ``begin`` appears in the port's folder, so that no touch gets into a reference.
"""

import faulthandler
import json
import os
import select
import signal
import sys
import traceback
from pathlib import Path
from time import perf_counter_ns

import numpy as np

from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.sensor.table import N_ROWS
from eitskin_tools.virtual_skin import server
from eitskin_tools.virtual_skin.device import Identity, VirtualDevice
from eitskin_tools.virtual_skin.faults import FOREIGN_ID, FaultPlayer, parse
from eitskin_tools.virtual_skin.process import configuration_for
from eitskin_tools.virtual_skin.pty import PtyPort

WIRE_FRAMES = 1 << 17


def untouched():
    """Return (104,) V that span a factor of 477, as a sheet's do."""
    rows = np.arange(N_ROWS)
    return 1e-3 * 477.0 ** (-rows / (N_ROWS - 1))


class MadeUp:
    """Voltages whose relative change is a fixed pattern times an amount, over given intervals."""

    def __init__(self, touches, noise, dead_rows, drift_per_s, base):
        self.touches, self.noise, self.drift_per_s = touches, noise, drift_per_s
        self.base = np.array(base) if base else untouched()
        self.base[dead_rows] = 0.0
        self.pattern = np.cos(np.arange(N_ROWS))
        self.rng = np.random.default_rng(7)
        self.began_s, self.begin = 0.0, None

    def wait_for(self, begin):
        """Let no touch begin before a file is there."""
        self.began_s, self.begin = None, begin

    def voltages(self, time_s):
        if self.began_s is None and self.begin.exists():
            self.began_s = time_s
        since_s = -1.0 if self.began_s is None else time_s - self.began_s
        amount = sum(amount for start, end, amount in self.touches if start <= since_s < end)
        drifted = self.base * (1 + self.drift_per_s * time_s)
        return drifted * (1 + amount * self.pattern + self.noise * self.rng.standard_normal(N_ROWS))


class PatientPort(PtyPort):
    """A line with room for every frame, sooner or later: what a busy host reads late is not lost."""

    stopping = False

    def write(self, data):
        while not super().write(data):
            if self.stopping or not self.plugged:
                return False
            select.select([], [self.fileno()], [], 0.1)
        return True


class NotingServer(server.SkinServer):
    """Notes when each frame was on the line, rather than when there was to be room for it."""

    def _scan(self, due_ns):
        sequence = self.device.sequence
        super()._scan(due_ns)
        self._record_wire_time(sequence, self._clock())


def main(options):
    player = FaultPlayer([parse(text) for text in options.get("faults", [])], seed=3)
    source = MadeUp(
        options.get("touches", []), options.get("noise", 1e-4), options.get("dead_rows", []),
        options.get("drift_per_s", 0.0), options.get("base"),
    )  # fmt: skip
    configuration = configuration_for(options.get("rate_hz", 100.0), options.get("configuration", "paper"))
    identity = Identity(
        options.get("serial_number", "VIRTUAL-0001"),
        FOREIGN_ID if player.foreign else PROTOCOL_ID,
        options.get("first_us", 0),
    )
    server.MAX_DELAY_NS = 10 * 10**9  # on a busy machine a scan comes late rather than never: loss is what tests inject
    port = PatientPort()
    if options.get("touches_wait"):
        source.wait_for(Path(port.path).parent / "begin")
    device = VirtualDevice(source, configuration, perf_counter_ns(), identity)
    device.sequence = options.get("sequence", 0)
    wire = server.wire_times(options["wire"], WIRE_FRAMES) if "wire" in options else None
    skin = NotingServer(device, port, player, wire)

    def stop(number, frame):
        # No exception: one that is raised within a callback of somebody's C code is lost, and the stop with it.
        port.stopping = True
        skin.stop()

    signal.signal(signal.SIGTERM, stop)
    faulthandler.register(signal.SIGUSR1)  # shows where a process hangs that does not end
    try:
        print(port.path, os.getpid(), flush=True)
        skin.run(perf_counter_ns() + int(300e9))
    finally:
        port.close()


def make_each():
    """Make a skin of each line of standard input."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for them here
    for line in sys.stdin:
        if os.fork() == 0:
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            try:
                main(json.loads(line))
            except Exception:
                traceback.print_exc()
            os._exit(0)


if __name__ == "__main__":
    main(json.loads(sys.argv[1])) if len(sys.argv) > 1 else make_each()
