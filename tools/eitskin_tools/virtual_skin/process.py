"""The process of the virtual skin: prepares its script, opens its port, says where it is, and serves.

The first line on standard output is the port's path, or one JSON object that also holds the host time at which the
device clock showed 0. Everything that happens later goes to the log file, one JSON object a line: boot, start, fault,
plug, stop.
"""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.wire import config_toml
from eitskin_proto.wire.config import Configuration
from eitskin_proto.wire.frames import full_scale
from eitskin_sim.measurement.noise import add_noise
from eitskin_tools.processes.signals import Stopped, endings, met_by, stop
from eitskin_tools.virtual_skin.device import CONVERTER_V, Identity, VirtualDevice
from eitskin_tools.virtual_skin.faults import FOREIGN_ID, Fault, FaultPlayer
from eitskin_tools.virtual_skin.pty import PtyPort
from eitskin_tools.virtual_skin.server import SkinServer, wire_times

if TYPE_CHECKING:
    from eitskin_tools.scripted_scene.keyframes import Keyframes
    from eitskin_tools.scripted_scene.script import Script


def configuration_for(rate_hz: float, name: str = "paper") -> Configuration:
    """Return a named configuration at a rate, with less settling and averaging where its own are too slow for it.

    Args:
        rate_hz: Frames a second.
        name: Of a shipped configuration, or the path of a TOML file.

    Raises:
        ValueError: The electronics cannot reach the rate; the largest is given.
    """
    asked = replace(config_toml.load(name), rate_mHz=round(rate_hz * 1000))
    quick = replace(asked, frequency_hz=100_000, averages=1, settle_us=20)
    for candidate in (asked, replace(asked, frequency_hz=50_000, averages=4, settle_us=40), quick):
        if 1e9 / candidate.scan_us() >= candidate.rate_mHz:
            return candidate
    raise ValueError(f"a rate of {rate_hz:g} Hz is too high: the electronics reach {int(1e6 / quick.scan_us())} Hz")


Array = npt.NDArray[np.float64]


@dataclass(slots=True, eq=False)
class Noise:
    """Noise of one kind at one level, in order from a seed.

    Args:
        kind: "N1", "N2", "N3" or "none"; see :mod:`eitskin_sim.measurement.noise`.
        snr_db: Signal to noise ratio.
        seed: Of the generator.
        reference: (104,) V, flat and untouched; N1 needs it.
        converter_V: Noise of the converter itself, that every front end has; none with "none".
    """

    kind: str = "N2"
    snr_db: float = 50.0
    seed: int = 0
    reference: Array | None = None
    converter_V: float = 0.0
    _rng: np.random.Generator = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    def on(self, voltages: Array) -> Array:
        """Return (104,) V as a noisy front end measures them."""
        reference = voltages if self.reference is None else self.reference
        noisy = add_noise(voltages, reference, self.kind, self.snr_db, self._rng)  # type: ignore[arg-type]
        if self.kind != "none" and self.converter_V > 0.0:
            noisy = noisy + self.converter_V * self._rng.standard_normal(noisy.shape)
        return noisy


@dataclass(frozen=True, slots=True, eq=False)
class ScriptSource:
    """Voltages of a script, interpolated between its keyframes."""

    script: "Script"
    keyframes: "Keyframes"
    noise: Noise

    def voltages(self, time_s: float) -> Array:
        """Return the (104,) V at a time since the first START."""
        return self.noise.on(self.script.voltages_at(time_s, self.keyframes))


WIRE_CAPACITY = 1 << 20
"""Frames whose times on the wire are kept: 87 minutes at 200 frames/s, 8 MiB."""


def serve(arguments: argparse.Namespace, script: "Script", faults: Sequence[Fault]) -> int:
    """Run a virtual skin until it is stopped or its time is over; return the exit status.

    Args:
        arguments: Of ``eitskin virtual-skin``.
        script: What it shows.
        faults: What happens to it.

    Raises:
        ValueError: A rate that the electronics cannot reach.
        OSError: A file cannot be written.
    """
    with met_by(stop, *endings()), suppress(Stopped), ExitStack() as stack:
        server = _build(arguments, script, faults, stack)
        until = None if arguments.seconds is None else perf_counter_ns() + int(arguments.seconds * 1e9)
        server.run(until)
    return 0


def _build(arguments: argparse.Namespace, script: "Script", faults: Sequence[Fault], stack: ExitStack) -> SkinServer:
    from eitskin_tools.scripted_scene.script import prepare

    configuration = configuration_for(arguments.rate, arguments.config)
    player = FaultPlayer(faults, arguments.seed)
    until_s = script.period_s if arguments.seconds is None else arguments.seconds
    solved = prepare(script, until_s)
    count_V = CONVERTER_V / configuration.gain / full_scale(configuration.sample_bytes)
    noise = Noise(arguments.noise, arguments.snr_db, arguments.seed, script.voltages_at(0.0, solved), count_V)
    log = stack.enter_context(arguments.log.open("w", buffering=1)) if arguments.log else None
    times = wire_times(arguments.wire_times, WIRE_CAPACITY) if arguments.wire_times else None
    port = stack.enter_context(PtyPort())
    identity = Identity(arguments.serial_number, FOREIGN_ID if player.foreign else PROTOCOL_ID)
    device = VirtualDevice(ScriptSource(script, solved, noise), configuration, perf_counter_ns(), identity)

    def write(event: dict[str, Any]) -> None:
        if log:
            log.write(json.dumps(event) + "\n")

    server = SkinServer(device, port, player, times, write)

    def last() -> None:
        told = {"sent": server.sent, "dropped": device.dropped, "overruns": port.overruns}
        write({"event": "stop", "host_ns": perf_counter_ns(), **told})

    stack.callback(last)
    _announce(arguments, port, device, player, script.name)
    return server


def _announce(
    arguments: argparse.Namespace, port: PtyPort, device: VirtualDevice, player: FaultPlayer, script: str
) -> None:
    if arguments.json:
        found = {
            "port": str(port.path),
            "pid": os.getpid(),
            "script": script,
            "rate_hz": device.rate_mHz / 1000,
            "serial_number": arguments.serial_number,
            "clock_epoch_ns": device.epoch_ns,
            "noise": arguments.noise,
            "snr_db": arguments.snr_db,
            "seed": arguments.seed,
            "faults": [fault.kind for fault in player.faults],
        }
        print(json.dumps(found), flush=True)
    else:
        print(port.path, flush=True)
        with suppress(OSError):
            print(
                f"eitskin virtual-skin: {script} at {device.rate_mHz / 1000:g} frames/s on {port.path}", file=sys.stderr
            )
