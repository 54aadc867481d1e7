"""A virtual skin on a mocked USB bus, as a process of its own, and the host's handle to it.

::

    host: pyusb, real libusb --(LD_PRELOAD, UMOCKDEV_DIR)--> umockdev --> this process: usb_bus, the skin's server
      one line a command on its standard input: unplug SECONDS          one JSON object at the start

The host's programs need the bus's environment and nothing else: ``eitskin run --port usb:SERIAL`` is unchanged.
"""

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Final, Self

import numpy as np
import numpy.typing as npt
from tests.faults.usb_bus import BusPort

from eitskin_proto.errors import SkinError
from eitskin_proto.sensor.table import N_ROWS
from eitskin_tools.virtual_skin.device import Identity, VirtualDevice
from eitskin_tools.virtual_skin.faults import Fault, FaultPlayer
from eitskin_tools.virtual_skin.process import configuration_for
from eitskin_tools.virtual_skin.server import SkinServer

ROOT: Final = Path(__file__).resolve().parents[2]
"""The checkout, from which this module runs as a program."""

WRAPPER: Final = "umockdev-wrapper"
"""Debian's program that preloads umockdev's library."""


class Steady:
    """Voltages that are not all alike, with noise: a reference is refused whose frames repeat each other bit by bit."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)

    def voltages(self, time_s: float) -> npt.NDArray[np.float64]:
        """Return the (104,) V at a time since the first START."""
        rows: npt.NDArray[np.float64] = np.linspace(-0.1, -0.001, N_ROWS)
        return rows * (1.0 + 1e-4 * self._rng.standard_normal(N_ROWS))


class Puller(FaultPlayer):
    """Plays an unplug at the next scan after it was asked for."""

    def __init__(self) -> None:
        super().__init__()
        self._asked: list[Fault] = []

    def ask(self, kind: str, amount: float) -> None:
        """Ask for a fault; may be called from another thread."""
        self._asked.append(Fault(kind, amount=amount))

    def due(self, time_s: float) -> list[Fault]:
        """Return what was asked for."""
        due, self._asked = self._asked, []
        return due


def missing() -> str:
    """Return why the mocked bus cannot be used on this machine; empty if it can."""
    if shutil.which(WRAPPER) is None:
        return f"{WRAPPER} not found: apt-get install umockdev gir1.2-umockdev-1.0 python3-gi"
    tried = subprocess.run(
        [sys.executable, "-c", "from tests.faults.usb_bus import bindings; bindings()"],
        capture_output=True, text=True, check=False, cwd=ROOT,
    )  # fmt: skip
    return "" if tried.returncode == 0 else tried.stderr.strip().splitlines()[-1]


class MockedUsb:
    """A virtual skin on a mocked bus; leaving the context ends it.

    Args:
        serial_number: What the device says on the bus and in HELLO.
        rate_hz: Frames a second of its configuration.

    Raises:
        SkinError: umockdev cannot be used here.
    """

    def __init__(self, serial_number: str = "USB-0001", rate_hz: float = 200.0) -> None:
        if shutil.which(WRAPPER) is None:
            raise SkinError(missing())
        self.port = f"usb:{serial_number}"
        """What ``--port`` is given."""
        self._process = subprocess.Popen(
            [WRAPPER, sys.executable, "-m", "tests.faults.usb_skin", serial_number, str(rate_hz)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
            env={name: value for name, value in os.environ.items() if name != "UMOCKDEV_DIR"},
        )  # fmt: skip
        assert self._process.stdout is not None
        self.bus: dict[str, str] = {}
        """The environment variables that show this bus."""
        line = self._process.stdout.readline()
        if not line:
            self.close()
            raise SkinError(missing() or "the mocked USB bus ended before it began")
        self.bus = json.loads(line)
        self.environment = {**os.environ, **self.bus}
        """Of a host process that is to see this bus instead of the machine's."""

    def tell(self, command: str) -> None:
        """Send a command: ``unplug SECONDS``."""
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()

    def close(self) -> None:
        """End the device and its bus."""
        if self._process.stdin is not None:
            self._process.stdin.close()  # the process ends with its input
        try:
            self._process.wait(30.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        if self.bus:
            shutil.rmtree(self.bus["UMOCKDEV_DIR"], ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def main(serial_number: str, rate_hz: float) -> None:
    """Serve until standard input ends."""
    port = BusPort(serial_number)
    puller = Puller()
    device = VirtualDevice(Steady(), configuration_for(rate_hz), time.perf_counter_ns(), Identity(serial_number))
    server = SkinServer(device, port, puller)
    threading.Thread(target=server.run, daemon=True).start()
    print(json.dumps(port.environment), flush=True)
    for line in sys.stdin:
        word, *rest = line.split()
        if word == "unplug":
            puller.ask("unplug", float(rest[0]))
    port.close()


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
