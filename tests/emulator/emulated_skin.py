"""The skin of ``eitskin demo --device qemu``: the real firmware on an emulated board, playing the script's voltages.

::

    QEMU, UART on a pty  <-->  this process  <-->  a pty with a stable name  <-->  the runtime
          plays a recording       notes when each frame passed, and what the first START began

It says the same on standard output and in its log as ``eitskin virtual-skin`` does, so that the rest of the
demonstration cannot tell the two apart. Voltages are solved beforehand; noise is part of the recording and repeats
with it.
"""

import argparse
import json
import os
import select
import signal
import sys
import tempfile
import tty
from collections.abc import Callable
from pathlib import Path
from time import perf_counter_ns
from types import FrameType
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from tests.emulator.board import Board, new_storage, record
from tests.emulator.patience import patient

from eitskin.acquisition.serial_port import SerialPort
from eitskin_proto.errors import SkinError
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.toml import load
from eitskin_proto.wire import config_toml
from eitskin_proto.wire.codes import MessageType
from eitskin_proto.wire.frames import FrameView
from eitskin_proto.wire.framing import Deframer
from eitskin_proto.wire.scan_rows import ALL_DRIVES, table_rows
from eitskin_tools.flash import procedure
from eitskin_tools.scripted_scene.script import prepare
from eitskin_tools.virtual_skin.process import WIRE_CAPACITY, Noise, configuration_for
from eitskin_tools.virtual_skin.pty import PtyPort
from eitskin_tools.virtual_skin.server import MAX_WAIT_S, wire_times

LONGEST_S: Final = 60.0
"""Longer scripts are cut off; the board's memory holds 90 s at 200 frames/s."""

HELD_S: Final = 2.0
"""Length of the recording of a scene that is held: after that its noise repeats."""


CONVERTER_NOISE_V: Final = 4e-8
"""A count of 24 bit at the usual gain: no front end is without noise."""


def recording(rate_hz: float, scene: Path | None, noise: str, seed: int, skin: Skin = PAPER) -> npt.NDArray[np.float64]:
    """Return the (frames, 208) V of a whole period of the script, with noise; reciprocal rows are equal."""
    from eitskin_tools.scripted_scene.script import script_of

    script = script_of(scene, skin)
    length_s = min(script.period_s, LONGEST_S) if np.isfinite(script.period_s) else HELD_S
    solved = prepare(script, length_s)
    source = Noise(noise, 50.0, seed, script.voltages_at(0.0, solved), CONVERTER_NOISE_V)
    rows = [source.on(script.voltages_at(i / rate_hz, solved)) for i in range(round(length_s * rate_hz))]
    return np.array(rows)[:, table_rows(True, ALL_DRIVES)]


class Relay:
    """Passes bytes between the board and the port, and notes when frames pass.

    What the port does not take yet is kept, and the board is not read meanwhile: its own buffer fills, and the firmware
    drops whole frames and counts them. Nothing is lost here.

    Args:
        board: Descriptor of the board's line.
        port: What the runtime opens.
        wire_ns: (capacity,) takes the host time of each sequence number.
        log: Takes an event.
    """

    def __init__(
        self, board: int, port: PtyPort, wire_ns: npt.NDArray[np.int64], log: Callable[[dict[str, Any]], None]
    ) -> None:
        self._board = board
        self._port = port
        self._wire_ns = wire_ns
        self._log = log
        self._deframer = Deframer()
        self._view = FrameView()
        self.sent = 0
        """Frames that passed."""
        self.dropped = 0
        """Scans that the board could not send, by its own count in each frame."""
        self._count = 0

    def run(self, until_ns: int) -> None:
        """Relay until the host's clock shows ``until_ns``."""
        while (now := perf_counter_ns()) < until_ns:
            port = self._port.fileno()
            heard = [port] if self._port.unsent else [port, self._board]
            full = [port] if self._port.unsent else []
            rest_s = min((until_ns - now) * 1e-9, MAX_WAIT_S)
            readable, writable, _ = select.select(heard, full, [], rest_s)
            if writable:
                self._port.flush()
            if port in readable:
                os.write(self._board, self._port.read())
            if self._board in readable:
                data = os.read(self._board, 65536)
                self._note(data, perf_counter_ns())
                self._port.queue(data)

    def _note(self, data: bytes, now: int) -> None:
        for payload in self._deframer.feed(data):
            if payload[0] != MessageType.FRAME:
                continue
            self._view.load(payload)
            self._wire_ns[self._view.sequence % len(self._wire_ns)] = now
            count = self._view.device_dropped
            self.dropped += count - self._count if count >= self._count else count  # it starts anew with each START
            self._count = count
            if self.sent == 0:
                self._log({"event": "start", "host_ns": now, "device_us": self._view.device_us, "script_time_s": 0.0})
            self.sent += 1


def _flash(board: Board, rate_hz: float) -> None:
    """Give the board the configuration for this rate, unless it has it: as a robot's owner would, with ``flash``."""
    wanted = configuration_for(rate_hz)
    if wanted == config_toml.named("paper"):
        return  # built into the firmware
    line = SerialPort(board.port)
    try:
        procedure.write(patient(line), wanted)
    finally:
        line.close()


def main(argv: list[str] | None = None) -> int:
    """Serve until stopped; the arguments are those of ``eitskin virtual-skin``."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rate", type=float, default=200.0)
    parser.add_argument("--scene", type=Path)
    parser.add_argument("--skin", type=Path)
    parser.add_argument("--noise", default="N2")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--wire-times", type=Path, required=True)
    parser.add_argument("--json", action="store_true", help="always on; as eitskin virtual-skin has it")
    arguments = parser.parse_args(argv)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop)
    try:
        _serve(arguments)
    except KeyboardInterrupt:
        return 0
    except (SkinError, ValueError, OSError) as error:
        print(f"emulated skin: {error}", file=sys.stderr)
        return 1
    return 0


def _stop(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _serve(arguments: argparse.Namespace) -> None:
    skin = PAPER if arguments.skin is None else load(arguments.skin)
    volts = recording(arguments.rate, arguments.scene, arguments.noise, arguments.seed, skin)
    with tempfile.TemporaryDirectory(prefix="eitskin-board-") as folder, arguments.log.open("w", buffering=1) as log:
        storage = Path(folder) / "storage.bin"
        new_storage(storage)
        record(storage, volts, configuration_for(arguments.rate).gain, arguments.rate)

        def write(event: dict[str, Any]) -> None:
            log.write(json.dumps(event) + "\n")

        with Board(storage) as board, PtyPort() as port:
            _flash(board, arguments.rate)
            line = os.open(board.port, os.O_RDWR | os.O_NOCTTY)
            relay = Relay(line, port, wire_times(arguments.wire_times, WIRE_CAPACITY), write)
            try:
                tty.setraw(line)
                print(json.dumps({"port": str(port.path), "device": "qemu", "rate_hz": arguments.rate}), flush=True)
                relay.run(perf_counter_ns() + int(arguments.seconds * 1e9))
            finally:
                os.close(line)
                told = {"sent": relay.sent, "dropped": relay.dropped, "overruns": port.overruns}
                write({"event": "stop", "host_ns": perf_counter_ns(), **told})


if __name__ == "__main__":
    sys.exit(main())
