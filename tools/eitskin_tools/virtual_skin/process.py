"""The process of the virtual skin: prepares its script, opens its port, says where it is, and serves.

The first line on standard output is the port's path, or one JSON object that also holds the host time at which the
device clock showed 0. Everything that happens later goes to the log file, one JSON object a line: boot, start, fault,
plug, stop.
"""

import json
import os
import signal
import sys
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter_ns
from types import FrameType
from typing import Any

from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.wire.frames import full_scale
from eitskin_tools.processes.signals import endings
from eitskin_tools.virtual_skin.configure import configuration_for
from eitskin_tools.virtual_skin.device import CONVERTER_V, VirtualDevice
from eitskin_tools.virtual_skin.faults import FOREIGN_ID, Fault, FaultPlayer
from eitskin_tools.virtual_skin.identity import Identity
from eitskin_tools.virtual_skin.pty import PtyPort
from eitskin_tools.virtual_skin.server import SkinServer, wire_times
from eitskin_tools.virtual_skin.sources import Noise, ScriptSource

WIRE_CAPACITY = 1 << 20
"""Frames whose times on the wire are kept: 87 minutes at 200 frames/s, 8 MiB."""


@dataclass(frozen=True, slots=True)
class Options:
    """What a virtual skin is like."""

    rate_hz: float = 200.0
    configuration: str = "paper"
    scene: Path | None = None
    """A scene to hold; the demonstration's script if None."""
    skin: Skin = PAPER
    seconds: float | None = None
    """Of serving, from when the port appears; for ever if None."""
    seed: int = 0
    noise: str = "N2"
    snr_db: float = 50.0
    faults: tuple[Fault, ...] = ()
    serial_number: str = "VIRTUAL-0001"
    first_us: int = 0
    """What the device clock shows at boot."""
    json: bool = False
    log: Path | None = None
    wire_times: Path | None = None
    """File of the host time of every frame, :func:`eitskin_tools.virtual_skin.server.wire_times`."""


class _Stopped(BaseException):
    """A signal that asks for an end arrived."""


def _stop(number: int, frame: FrameType | None) -> None:
    for handled in endings():
        signal.signal(handled, signal.SIG_IGN)
    raise _Stopped


def serve(options: Options) -> int:
    """Run a virtual skin until it is told to stop or its time is over; return the exit status.

    Raises:
        ValueError: A rate that the electronics cannot reach, or another option that makes no sense.
        SceneError: The scene's file is no scene.
        OSError: A file cannot be read or written.
    """
    before = {number: signal.signal(number, _stop) for number in endings()}
    try:
        with ExitStack() as stack:
            server = _build(options, stack)
            until = None if options.seconds is None else perf_counter_ns() + int(options.seconds * 1e9)
            server.run(until)
    except _Stopped:
        pass
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0


def _build(options: Options, stack: ExitStack) -> SkinServer:
    from eitskin_tools.scripted_scene.prepare import prepare
    from eitskin_tools.scripted_scene.script import script_of

    configuration = configuration_for(options.rate_hz, options.configuration)
    player = FaultPlayer(options.faults, options.seed)
    script = script_of(options.scene, options.skin)
    until_s = script.period_s if options.seconds is None else options.seconds
    solved = prepare(script, until_s)
    count_V = CONVERTER_V / configuration.gain / full_scale(configuration.sample_bytes)
    noise = Noise(options.noise, options.snr_db, options.seed, script.voltages_at(0.0, solved), count_V)
    log = stack.enter_context(options.log.open("w", buffering=1)) if options.log else None
    times = wire_times(options.wire_times, WIRE_CAPACITY) if options.wire_times else None
    port = stack.enter_context(PtyPort())
    identity = Identity(options.serial_number, FOREIGN_ID if player.foreign else PROTOCOL_ID, options.first_us)
    device = VirtualDevice(ScriptSource(script, solved, noise), configuration, perf_counter_ns(), identity)

    def write(event: dict[str, Any]) -> None:
        if log:
            log.write(json.dumps(event) + "\n")

    server = SkinServer(device, port, player, times, write)

    def last() -> None:
        told = {"sent": server.sent, "dropped": device.dropped, "overruns": port.overruns}
        write({"event": "stop", "host_ns": perf_counter_ns(), **told})

    stack.callback(last)
    _announce(options, port, device, script.name)
    return server


def _announce(options: Options, port: PtyPort, device: VirtualDevice, script: str) -> None:
    if options.json:
        found = {
            "port": str(port.path),
            "pid": os.getpid(),
            "script": script,
            "rate_hz": device.rate_mHz / 1000,
            "serial_number": options.serial_number,
            "clock_epoch_ns": device.epoch_ns,
            "noise": options.noise,
            "snr_db": options.snr_db,
            "seed": options.seed,
            "faults": [fault.kind for fault in options.faults],
        }
        print(json.dumps(found), flush=True)
    else:
        print(port.path, flush=True)
        with suppress(OSError):
            print(
                f"eitskin virtual-skin: {script} at {device.rate_mHz / 1000:g} frames/s on {port.path}", file=sys.stderr
            )
