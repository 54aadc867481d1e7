"""A virtual skin behind a pseudo-terminal that is as a file says: "flat" or "pressed", whatever the time.

Takes a JSON object as its argument: ``state`` (the file's path), ``volts`` ({state: 104 V}). Prints the port's path.
"""

import json
import signal
import sys
from pathlib import Path
from time import perf_counter_ns

import numpy as np

from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_tools.virtual_skin import server
from eitskin_tools.virtual_skin.device import Identity, VirtualDevice
from eitskin_tools.virtual_skin.faults import FaultPlayer
from eitskin_tools.virtual_skin.process import configuration_for
from eitskin_tools.virtual_skin.pty import PtyPort


class Sheet:
    """Voltages of the state that stands in a file."""

    def __init__(self, options):
        self.path = Path(options["state"])
        self.volts = {name: np.array(volts) for name, volts in options["volts"].items()}
        self.rng = np.random.default_rng(5)

    def voltages(self, time_s):
        volts = self.volts[self.path.read_text()]
        return volts * (1.0 + 0.003 * self.rng.standard_normal(len(volts)))


def main(options):
    server.MAX_DELAY_NS = 10 * 10**9  # on a busy machine a scan comes late rather than never
    port = PtyPort()
    identity = Identity("VIRTUAL-0001", PROTOCOL_ID, 0)
    device = VirtualDevice(Sheet(options), configuration_for(100.0, "paper"), perf_counter_ns(), identity)
    skin = server.SkinServer(device, port, FaultPlayer([], 1))
    signal.signal(signal.SIGTERM, lambda *_: skin.stop())
    try:
        print(port.path, flush=True)
        skin.run(perf_counter_ns() + int(300e9))
    finally:
        port.close()


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
