"""Commands that greet a device which lies from the first byte: they end, say one line, and show no escape codes."""

import subprocess
import sys
import tempfile
from typing import Any, Final

from ..device.lies import lies_of_hello
from ..outcome import Effort, Outcome
from ..stream import ROOT, TINY
from .trial import device

LIMIT_S: Final = 60.0
REFUSED: Final = {
    *("magic", "protocol_major", "protocol_id", "grid_id", "serial_number", "sample_bytes", "drives"),
    "volts_per_count",
}
"""Fields of which ``eitskin run`` takes no wrong value."""


def _ended(port: str, *command: str) -> tuple[int | None, str]:
    """Return the exit status, None if it did not end, and all that a command said."""
    with tempfile.TemporaryDirectory(prefix="c") as folder:
        further = ["--port", port]
        if command[0] == "run":
            further += ["--frames", "30", "--bundle", str(TINY), "--reference-frames", "20", "--quiet"]
            further += ["--publish", f"ipc://{folder}/f", "--control", f"ipc://{folder}/c"]
        try:
            done = subprocess.run(
                [sys.executable, "-m", "eitskin_tools.cli", *command, *further],
                check=False,
                capture_output=True,
                text=True,
                timeout=LIMIT_S,
                cwd=ROOT,
            )
        except subprocess.TimeoutExpired as error:
            return None, str(error.stderr)
    return done.returncode, done.stdout + done.stderr


def _problem(status: int | None, said: str, command: str) -> str:
    """Return what is wrong with how a command ended, or nothing."""
    if status is None:
        return f"did not end within {LIMIT_S} s"
    if "Traceback" in said or any(ord(letter) < 32 and letter != "\n" for letter in said):
        return f"said {said[-300:]!r}"
    if status != 0 and not said.strip().splitlines()[-1].startswith(f"eitskin {command}: "):
        return f"status {status} without a line: {said[-200:]!r}"
    return "" if status in (0, 1) else f"status {status}"


def hello(effort: Effort) -> Outcome:
    """Every wrong value of every field of HELLO, from the first greeting."""
    outcome = Outcome("device.hello")
    tried: set[str] = set()
    for number in range(effort.count(1, 3)):
        for name, value in lies_of_hello(number + effort.seed).items():
            if repr((name, value)) in tried or (not effort.long and name not in ("serial_number", "volts_per_count")):
                continue
            tried.add(repr((name, value)))
            said_as: Any = value.hex() if isinstance(value, bytes) else value
            for command in (("run",), ("doctor",), ("flash", "show"))[: effort.count(1, 3)]:
                with device(hello={name: said_as}) as skin:
                    status, said = _ended(skin.port, *command)
                problem = _problem(status, said, command[0])
                if command == ("run",) and name in REFUSED and status == 0:
                    problem = "taken"
                outcome.note(not problem, f"{command[0]}, {name} {value!r}: {problem}")
    return outcome


def stored(effort: Effort) -> Outcome:
    """``flash show`` and ``doctor`` end, whatever the device answers to CONFIG_READ."""
    outcome = Outcome("device.stored")
    kinds = ("empty", "short", "elsewhere", "endless", "none", "random", "done", "unknown", "other")
    for kind in kinds[: effort.count(2, len(kinds))]:
        for command in (("flash", "show"), ("doctor",))[: effort.count(1, 2)]:
            with device() as skin:
                skin.start(do="stored", kind=kind, seed=effort.seed, seconds=2 * LIMIT_S, frames=10**6)
                status, said = _ended(skin.port, *command)
            problem = _problem(status, said, command[0])
            outcome.note(not problem, f"{command[0]}, {kind}: {problem}")
    return outcome
