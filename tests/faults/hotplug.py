"""Pulling the plug again and again: each time the stream must resume, with no descriptor and no thread left behind.

``python -m tests.faults.hotplug [--cycles N] [--usb-cycles N]``. A virtual skin streams to a host over
:class:`eitskin.acquisition.hotplug.HotPlug`; after some frames the port vanishes and returns, first a pseudo-terminal
under another number, then a device on a mocked USB bus under a real libusb. One JSON line comes last; exit status 1 if
a stream did not resume or something leaked. Where umockdev is missing, the USB part says so and does not count.
"""

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, Final

from tests.faults.usb_skin import ROOT, MockedUsb, Puller, Steady, missing

from eitskin.acquisition.device import Device
from eitskin.acquisition.hotplug import HotPlug
from eitskin.acquisition.ports import open_line
from eitskin.errors import HandshakeError, PortLost, PortReturned
from eitskin_proto.wire.codes import MessageType
from eitskin_proto.wire.frames import FrameView, StreamCounter
from eitskin_tools.virtual_skin.device import Identity, VirtualDevice
from eitskin_tools.virtual_skin.process import configuration_for
from eitskin_tools.virtual_skin.pty import PtyPort
from eitskin_tools.virtual_skin.server import SkinServer

FRAMES: Final = 5
"""Frames that must arrive before the plug is pulled again."""

OUT_S: Final = 0.03
"""How long the plug is out."""

PATIENCE_S: Final = 60.0
"""A stream that has not resumed by then is broken."""

SETTLES_S: Final = 20.0
"""What is still there after this long is a leak; on a quiet machine what goes is gone at once."""


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

    @property
    def wrong(self) -> bool:
        """Whether a stream did not resume, or something was left behind."""
        return self.resumed != self.cycles or any((self.resets, self.leaked_descriptors, self.leaked_threads))


def pull(cycles: int, rate_hz: float = 200.0) -> Figures:
    """Pull the plug of a pseudo-terminal ``cycles`` times and return the figures."""
    puller = Puller()
    before, started_s = _held(), time.perf_counter()
    with PtyPort() as port:
        device = VirtualDevice(Steady(), configuration_for(rate_hz), time.perf_counter_ns(), Identity())
        server = SkinServer(device, port, puller)
        serving = threading.Thread(target=server.run, daemon=True)
        serving.start()
        try:
            followed = follow(str(port.path), cycles, lambda: puller.ask("unplug", OUT_S))
        finally:
            server.stop()
            serving.join(PATIENCE_S)
    return _figures(cycles, followed, before, started_s)


def pull_usb(cycles: int) -> dict[str, Any]:
    """Pull a device off a mocked USB bus ``cycles`` times and return the figures, or why that is impossible here."""
    lacking = missing()
    if lacking:
        return {"not_run": lacking}
    command = [sys.executable, "-m", "tests.faults.hotplug", "--host"]
    last = ""
    with (
        MockedUsb() as usb,
        subprocess.Popen(
            [*command, usb.port, "--cycles", str(cycles)],
            env=usb.environment,
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        ) as host,
    ):
        for line in host.stdout or ():
            if line.startswith("pull"):
                usb.tell(f"unplug {OUT_S}")
            last = line
    figures: dict[str, Any] = json.loads(last)
    return figures


def _host(port: str, cycles: int) -> Figures:
    """Follow a device whose plug the parent process pulls when this one writes a line."""
    open_line(port).close()  # libusb keeps a thread and some descriptors from its first use on
    before, started_s = _held(), time.perf_counter()
    followed = follow(port, cycles, lambda: print("pull", flush=True))
    return _figures(cycles, followed, before, started_s)


def _held() -> tuple[int, int]:
    """Return how many descriptors and threads this process has."""
    return len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))


def _figures(
    cycles: int, followed: tuple[int, int, StreamCounter], before: tuple[int, int], started_s: float
) -> Figures:
    resumed, frames, counter = followed
    after, end_s = _held(), time.perf_counter() + SETTLES_S
    while (
        any(now > then for now, then in zip(after, before, strict=True)) and time.perf_counter() < end_s
    ):  # a joined thread may outlive the join in the kernel
        time.sleep(0.01)
        after = _held()
    return Figures(
        cycles=cycles,
        resumed=resumed,
        frames=frames,
        lost_and_counted=counter.lost,
        resets=counter.resets,
        leaked_descriptors=after[0] - before[0],
        leaked_threads=after[1] - before[1],
        seconds=round(time.perf_counter() - started_s, 1),
    )


def follow(port: str, cycles: int, pull_plug: Callable[[], None]) -> tuple[int, int, StreamCounter]:
    """Stream, and have the plug pulled after every few frames; return how often it resumed, the frames, the counter."""
    counter, view = StreamCounter(), FrameView()
    line = HotPlug(port, give_up_s=PATIENCE_S)
    resumed = frames = since = 0
    try:
        skin = Device(line)
        skin.start()
        asked, heard_s = False, time.perf_counter()
        while time.perf_counter() - heard_s < PATIENCE_S:
            try:
                for payload in skin.payloads(1.0):
                    if payload[0] == MessageType.FRAME:
                        view.load(payload)
                        counter.step(view.sequence, view.device_us)
                        frames, since, heard_s = frames + 1, since + 1, time.perf_counter()
                if since >= FRAMES and resumed < line.returns:
                    resumed, asked = line.returns, False
                if since >= FRAMES and resumed == cycles:
                    break
                if since >= FRAMES and not asked:
                    asked = True
                    pull_plug()
            except PortReturned:
                if not _greet(skin):
                    break
                since = 0
            except PortLost:
                break
        with suppress(HandshakeError, PortLost, PortReturned):
            skin.stop()
    finally:
        line.close()
    return resumed, frames, counter


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
    parser.add_argument("--cycles", type=int, default=500, help="on a pseudo-terminal (default 500)")
    parser.add_argument("--usb-cycles", type=int, default=50, help="on a mocked USB bus (default 50)")
    parser.add_argument("--host", metavar="PORT", help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.host:
        print(json.dumps(asdict(_host(arguments.host, arguments.cycles))))
        return 0
    figures = pull(arguments.cycles)
    usb = pull_usb(arguments.usb_cycles) if arguments.usb_cycles else {"not_run": "no cycles were asked for"}
    print(json.dumps({"hotplug": asdict(figures), "usb": usb}))
    return 1 if figures.wrong or ("not_run" not in usb and Figures(**usb).wrong) else 0


if __name__ == "__main__":
    sys.exit(main())
