"""Power cut at every write of a flash: the device must come back with the old or the new configuration, never neither.

``python -m tests.faults.powercut [--seeds N] [--board-steps N] [--sequences N]`` first runs the host
model, where the word that was being written may be torn in any way, then the real firmware under QEMU, which is killed;
between them random sequences of requests, boots and cuts on the model (tests/faults/requests). One JSON line comes
last; exit status 1 if a device was lost.
"""

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from tests.emulator.board import Board, new_storage
from tests.emulator.device_core import HostDevice
from tests.emulator.firmware import missing_tools
from tests.emulator.patience import UntilStopped, patient
from tests.faults.requests.lines import CoreLine
from tests.faults.requests.search import Figures, search

from eitskin.acquisition.serial_port import SerialPort
from eitskin_proto.errors import SkinError
from eitskin_proto.wire import config_toml
from eitskin_proto.wire.config import Configuration
from eitskin_tools.flash import procedure
from eitskin_tools.flash.exchange import Exchange

OLD: Final = "full208"
NEW: Final = "fast"


def _write(name: str) -> Callable[[Exchange], object]:
    configuration = config_toml.named(name)
    return lambda exchange: procedure.write(exchange, configuration)


def _prepare(kind: str) -> tuple[HostDevice, set[str], Callable[[Exchange], object]]:
    """Return a device, the configurations it may end with, and what will be interrupted."""
    device = HostDevice()
    device.run(1000)
    exchange = Exchange(device)
    if kind == "first write":
        return device, {"paper", NEW}, _write(NEW)  # what is built in is the old one here
    _write("paper")(exchange)
    _write(OLD)(exchange)
    if kind == "write":
        return device, {OLD, NEW}, _write(NEW)
    if kind == "write after rollback":
        procedure.rollback(exchange)
        return device, {"paper", NEW}, _write(NEW)
    return device, {OLD, "paper"}, procedure.rollback


KINDS: Final = ("first write", "write", "write after rollback", "rollback")
"""What is interrupted."""


def count_changes(kind: str) -> int:
    """Return how many changes of storage one undisturbed run makes."""
    device, _, action = _prepare(kind)
    before = device.changes
    action(Exchange(device))
    return device.changes - before


def _name(device: HostDevice) -> str:
    device.take()
    shown = procedure.show(Exchange(device, timeout_s=0.1, attempts=2))
    if config_toml.named(shown.active.configuration.name) != shown.active.configuration:
        return "neither"
    return shown.active.configuration.name


def cut_once(kind: str, change: int, seed: int) -> str:
    """Interrupt one run and return what the device boots in the end.

    The device is booted three times: at the first, power may be cut again inside the boot's own write; at the third
    every trial is over. Then it must take a new configuration as if nothing had happened.

    Raises:
        SkinError: The device was lost; the text says where.
    """
    device, allowed, action = _prepare(kind)
    device.cut_power_at(change, seed)
    with suppress(SkinError):
        action(Exchange(device))
    booted = []
    for again in (1, 0, 0):
        if again:
            device.cut_power_at(1, seed)
        device.boot()
        if device.dead:
            device.boot()
        device.cut_power_at(0, 0)
        booted.append(_name(device))
    if not set(booted) <= allowed or booted[1] != booted[2]:
        raise SkinError(f"{kind}, change {change}, seed {seed}: booted {booted}, allowed are {sorted(allowed)}")
    _write("idle")(Exchange(device, timeout_s=0.1))
    if _name(device) != "idle":
        raise SkinError(f"{kind}, change {change}, seed {seed}: the device takes no new configuration any more")
    return booted[-1]


def cut_model(seeds: int) -> dict[str, object]:
    """Cut the power at every change of every kind, with every seed; return the figures."""
    outcome: Counter[str] = Counter()
    points, lost = 0, []
    for kind in KINDS:
        for change in range(1, count_changes(kind) + 1):
            points += 1
            for seed in range(seeds):
                try:
                    outcome[cut_once(kind, change, seed)] += 1
                except SkinError as error:
                    lost.append(str(error))
    return {"cut_points": points, "cuts": sum(outcome.values()) + len(lost), "booted": dict(outcome), "lost": lost}


def _board_name(storage: Path) -> Configuration:
    with Board(storage) as board:
        port = SerialPort(board.port)
        try:
            return procedure.show(patient(port)).active.configuration
        finally:
            port.close()


def _board_write(storage: Path, name: str, cut_at: int = 0, seed: int = 0) -> int:
    """Flash the emulated board, until its power is cut if ``cut_at`` says so; return the changes of storage made."""
    with Board(storage, cut_at, seed) as board:
        port = SerialPort(board.port)
        try:
            if cut_at == 0:
                _write(name)(patient(port))
                return board.changes
            gave_up = "the flash came to its end"
            try:
                _write(name)(patient(UntilStopped(port, lambda: board.stopped)))
            except SkinError as error:
                gave_up = str(error)
            if not board.stopped:
                raise SkinError(f"the board did not reach change {cut_at}; it made {board.changes}: {gave_up}")
            return board.changes
        finally:
            port.close()


def cut_board(steps: int) -> dict[str, Any]:
    """Kill the emulated board at changes spread over a whole flash; return the figures.

    Args:
        steps: At how many changes; 0 for every one.
    """
    outcome: Counter[str] = Counter()
    lost: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        storage, kept = Path(folder) / "storage.bin", b""
        new_storage(storage)
        _board_write(storage, OLD)
        kept = storage.read_bytes()
        total = _board_write(storage, NEW)
        spread = {1 + i * (total - 1) // max(1, steps - 1) for i in range(steps)}
        chosen = sorted(spread) if steps else range(1, total + 1)
        cuts = [(change, change % 4) for change in chosen] + [(total, 1)]  # the last: just after the confirmation
        for change, seed in cuts:
            storage.write_bytes(kept)
            _board_write(storage, NEW, change, seed)
            found = _board_name(storage)
            if found in (config_toml.named(OLD), config_toml.named(NEW)):
                outcome[found.name] += 1
            else:
                lost.append(f"change {change}: booted {found.name!r}")
    return {"cut_points": total, "cuts": len(cuts), "booted": dict(outcome), "lost": lost}


def cut_sequences(count: int, seed: int) -> Figures:
    """Play random sequences on the core in memory, and look at every change of storage; return the figures."""
    return search(CoreLine, count, seed)


def main(argv: list[str] | None = None) -> int:
    """Run it and print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=12, help="ways to tear each word; 0 and 1 cut before and after it")
    parser.add_argument("--board-steps", type=int, default=0, help="kills of the emulator; 0 for one at every change")
    parser.add_argument("--sequences", type=int, default=20_000, help="random sequences of requests on the host model")
    parser.add_argument("--seed", type=int, default=0, help="of the sequences")
    parser.add_argument("--no-board", action="store_true", help="host model only")
    arguments = parser.parse_args(argv)
    report: dict[str, object] = {"model": cut_model(arguments.seeds)}
    figures = cut_sequences(arguments.sequences, arguments.seed)
    report["sequences"] = figures.as_dict()
    missing = missing_tools("qemu")
    if arguments.no_board or missing:
        report["board"] = f"not run: {', '.join(missing)} not found" if missing else "not run"
    else:
        report["board"] = cut_board(arguments.board_steps)
    lost = [line for part in report.values() if isinstance(part, dict) for line in part["lost"]]
    for line in lost:
        print(line, file=sys.stderr)
    untold = figures.breaches + figures.differing - len(figures.lost)
    print(json.dumps({"powercut": report, "lost": len(lost) + untold}))
    return 1 if lost or untold else 0


if __name__ == "__main__":
    sys.exit(main())
