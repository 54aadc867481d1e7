"""Pulling the plug again and again: each time the stream must resume, with no descriptor and no thread left behind.

``python -m eitskin_tools.faults.hotplug --cycles N``. A virtual device on a pseudo-terminal streams to a host over
:class:`eitskin.hotplug.HotPlug`; after some frames the port vanishes and returns under another number. One JSON line
comes last; exit status 1 if a stream did not resume or something leaked.
"""

import argparse
import json
import os
import sys
import threading
import time
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.device import Device
from eitskin.errors import HandshakeError, PortLost, PortReturned
from eitskin.hotplug import HotPlug
from eitskin_proto.codes import MessageType
from eitskin_proto.frames import FrameView
from eitskin_proto.table import N_ROWS
from eitskin_proto.unwrap import StreamCounter
from eitskin_tools.skin.configure import configuration_for
from eitskin_tools.skin.device import Identity, VirtualDevice
from eitskin_tools.skin.faults import Fault, FaultPlayer
from eitskin_tools.skin.pty import PtyPort
from eitskin_tools.skin.server import SkinServer

FRAMES: Final = 5
"""Frames that must arrive before the plug is pulled again."""

OUT_S: Final = 0.03
"""How long the plug is out."""

PATIENCE_S: Final = 30.0
"""A stream that has not resumed by then is broken."""


class _Ramp:
    """Voltages that are not all alike."""

    def voltages(self, time_s: float) -> npt.NDArray[np.float64]:
        return np.linspace(-0.1, -0.001, N_ROWS)


class _Puller(FaultPlayer):
    """Pulls the plug at the next scan after ``pull`` was set."""

    def __init__(self) -> None:
        super().__init__()
        self.pull = threading.Event()

    def due(self, time_s: float) -> list[Fault]:
        if not self.pull.is_set():
            return []
        self.pull.clear()
        return [Fault("unplug", time_s, amount=OUT_S)]


@dataclass(frozen=True, slots=True)
class Figures:
    """What became of the cycles."""

    cycles: int
    resumed: int
    frames: int
    lost_and_counted: int
    resets: int
    leaked_descriptors: int
    leaked_threads: int
    seconds: float


def pull(cycles: int, rate_hz: float = 200.0) -> Figures:
    """Pull the plug so many times and return the figures."""
    descriptors, threads = len(os.listdir("/proc/self/fd")), threading.active_count()
    started_s = time.perf_counter()
    counter, puller = StreamCounter(), _Puller()
    with PtyPort() as port:
        device = VirtualDevice(_Ramp(), configuration_for(rate_hz), time.perf_counter_ns(), Identity())
        server = SkinServer(device, port, puller)
        serving = threading.Thread(target=server.run, daemon=True)
        serving.start()
        line = HotPlug(str(port.path), give_up_s=PATIENCE_S)
        try:
            resumed, frames = _follow(line, puller, counter, cycles)
        finally:
            server.stop()  # ends with its next scan: the device still streams
            serving.join(PATIENCE_S)
            line.close()
    return Figures(
        cycles=cycles,
        resumed=resumed,
        frames=frames,
        lost_and_counted=counter.lost,
        resets=counter.resets,
        leaked_descriptors=len(os.listdir("/proc/self/fd")) - descriptors,
        leaked_threads=threading.active_count() - threads,
        seconds=round(time.perf_counter() - started_s, 1),
    )


def _follow(line: HotPlug, puller: _Puller, counter: StreamCounter, cycles: int) -> tuple[int, int]:
    """Stream, and pull the plug after every few frames; return how often it resumed, and the frames."""
    skin, view = Device(line), FrameView()
    skin.start()
    resumed, frames, since = 0, 0, 0
    heard_s = time.perf_counter()
    while resumed < cycles and time.perf_counter() - heard_s < PATIENCE_S:
        try:
            for payload in skin.payloads(1.0):
                if payload[0] == MessageType.FRAME:
                    view.load(payload)
                    counter.step(view.sequence, view.device_us)
                    frames, since, heard_s = frames + 1, since + 1, time.perf_counter()
            if since >= FRAMES and not puller.pull.is_set() and line.returns == resumed:
                puller.pull.set()
        except PortReturned:
            if not _greet(skin):
                break
            resumed, since = line.returns, 0
        except PortLost:
            break
    return resumed, frames


def _greet(skin: Device) -> bool:
    """Shake hands anew; return whether the same device streams again."""
    while True:
        try:
            skin.recover()
            return True
        except PortReturned:
            continue
        except (HandshakeError, PortLost):
            return False


def main(argv: list[str] | None = None) -> int:
    """Run it and print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cycles", type=int, default=500)
    figures = pull(parser.parse_args(argv).cycles)
    wrong = figures.resumed != figures.cycles or figures.leaked_descriptors != 0 or figures.leaked_threads != 0
    print(json.dumps({"hotplug": asdict(figures)}))
    return 1 if wrong or figures.resets else 0


if __name__ == "__main__":
    sys.exit(main())
