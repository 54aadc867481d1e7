"""Whether the fast frame notices that frames are verified behind it.

One stream, one runtime. A subscriber asks for verdicts and leaves, in turns of a seventh of the script's 20 s, so that
every part of the script is seen with and without. Frames near a change of turn are left out.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import eitskin
from eitskin_tools.bench.harness import machine, program, show
from eitskin_tools.command_line import files
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.signals import Stopped, raise_stopped_on_signals

PHASE_S: Final = 20.0 / 7.0
"""Of a turn: the script has an odd number of them, so turns change places from one of its loops to the next."""

EDGE_NS: Final = 300_000_000
"""Behind each change of turn that is left out."""

START_S: Final = 300.0
"""How long any process may take to be ready."""


MODEL_TIMEOUT_S: Final = 300.0
"""How long the first model may take."""

TURNS: Final = "turns"
"""First word of the process that asks for verdicts and leaves again."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--frames", type=int, default=20_000, metavar="N", help="frames at each rate (default 20000)")
    parser.add_argument("--rate", type=float, action="append", metavar="HZ", help="default 200; repeatable")
    parser.add_argument("--bundle", type=files.bundle, metavar="FILE", help="bundle to run (default: the shipped one)")
    parser.add_argument("--mode", choices=("idle", "always"), default="always", help="of the verifier (default always)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.frames < 100:
        raise UsageError("--frames must be at least 100: percentiles need values")
    rates = arguments.rate or [200.0]
    found = [beside_verifier(rate, arguments.frames, arguments.bundle, arguments.mode) for rate in rates]
    show(arguments, {"streams": found, "machine": machine()})
    return 0


def beside_verifier(
    rate_hz: float, frames: int, bundle: Path | None, mode: str, phase_s: float = PHASE_S
) -> dict[str, Any]:
    """Return latencies of a stream while frames are verified, and while they are not.

    Args:
        rate_hz: Frames a second.
        frames: How many.
        bundle: To run; None for the shipped one.
        mode: "always" or "idle".
        phase_s: Of a turn.
    """
    from eitskin_tools.demo.recorder import Record
    from eitskin_tools.processes.children import GRACE_S, Child, process_group

    seconds = frames / rate_hz
    print(f"{frames} frames at {rate_hz:g} frames/s, verified in turns", file=sys.stderr)
    with tempfile.TemporaryDirectory(prefix="eitskin-bench-") as name, process_group() as children:
        folder = Path(name)
        publish = f"ipc://{folder}/frames"
        words = ["virtual-skin", "--json", f"--rate={rate_hz:g}", f"--seconds={seconds + 3 * START_S:g}"]
        skin = Child("virtual-skin", "eitskin_tools.cli", [*words, f"--wire-times={folder / 'wire.npy'}"], folder)
        children.append(skin)
        port = json.loads(skin.line(skin.out, "{", START_S))["port"]
        words = ["run", f"--port={port}", f"--publish={publish}", f"--control=ipc://{folder}/control", "--json"]
        words += [f"--verify={mode}"] + ([] if bundle is None else [f"--bundle={bundle}"])
        runtime = Child("run", "eitskin_tools.cli", words, folder)
        children.append(runtime)
        runtime.line(runtime.err, "ready ", START_S, children)
        words = [TURNS, publish, str(folder / "verdicts.npz"), str(phase_s)]
        here = Path(__file__)
        verdicts = Child("verdicts", here.stem, words, folder, {"PYTHONPATH": str(here.parent)})
        children.append(verdicts)
        verdicts.line(verdicts.out, "ready", START_S, children)
        words = [publish, str(folder / "record.npz"), f"--seconds={seconds}", f"--capacity={frames + 1000}"]
        subscriber = Child("subscriber", "eitskin_tools.demo.recorder", words, folder)
        children.append(subscriber)
        if subscriber.wait(seconds + START_S) != 0:
            subscriber.check()
        for child in (verdicts, runtime, skin):
            child.stop()
        verdicts.wait(GRACE_S)
        record, wire_ns = Record.load(folder / "record.npz"), np.load(folder / "wire.npy")
        with np.load(folder / "verdicts.npz", allow_pickle=False) as file:
            told = {key: np.array(file[key]) for key in file.files}
        summary = json.loads(runtime.out.read_text())
    found = compared(record, wire_ns, told["phases"])
    return {**found, "verifier": _verdicts(told), "mode": mode, "rate_hz": rate_hz, "state": summary["verifier"]}


def compared(record: Any, wire_ns: npt.NDArray[np.int64], phases: npt.NDArray[np.int64]) -> dict[str, Any]:
    """Return the latencies of frames in turns with verdicts and without, and their ratios.

    Args:
        record: What the subscriber to frames noted.
        wire_ns: When each sequence number went onto the wire.
        phases: (n, 2) ns, the turns with verdicts.
    """
    from eitskin_tools.demo.score import percentiles_us

    written = wire_ns[record.sequence % len(wire_ns)]
    came, known = record.received_ns, written > 0
    number = np.searchsorted(phases.ravel(), came, side="right")
    edges = np.concatenate([[came[0]], phases.ravel()]) if len(phases) else came[:1]
    kept = known & (came - edges[np.minimum(number, len(edges) - 1)] > EDGE_NS)
    inside = number % 2 == 1
    kept &= number < phases.size  # the last turn may have been broken off
    found: dict[str, Any] = {}
    for name, which in (("without", kept & ~inside), ("with", kept & inside)):
        own = came - written
        found[name] = {
            "frames": int(which.sum()),
            "latency_us": percentiles_us(own[which]),
            "inferred": int((which & record.inferred).sum()),
            "latency_inferred_us": percentiles_us(own[which & record.inferred]),
        }
    found["lost"] = int(record.sequence[-1] - record.sequence[0] + 1 - len(record.sequence))
    found["ratio"] = {
        of: {
            key: round(found["with"][of][key] / found["without"][of][key], 3)
            for key in ("p50", "p99")
            if found["with"][of] and found["without"][of]
        }
        for of in ("latency_us", "latency_inferred_us")
    }
    return found


def _verdicts(told: dict[str, Any]) -> dict[str, Any]:
    def quantiles(values: npt.NDArray[np.float64]) -> dict[str, float]:
        return {name: round(float(np.percentile(values, at)), 2) for name, at in (("p50", 50), ("p99", 99))} if len(
            values
        ) else {}  # fmt: skip

    checked, flagged, skipped = (int(count) for count in told["counts"])
    return {
        "checked": checked, "flagged": flagged, "skipped": skipped, "verdicts": len(told["spent_ms"]),
        "spent_ms": quantiles(told["spent_ms"]), "behind_frame_ms": quantiles(told["behind_ms"]),
    }  # fmt: skip


def take_turns(endpoint: str, phase_s: float, path: Path) -> None:
    """Ask for verdicts in every other phase until told to stop, and write down when, and what came.

    Args:
        endpoint: Where the runtime publishes.
        phase_s: Of a phase.
        path: File to write: ``phases`` (n, 2) begin and end in ns; ``spent_ms``, ``behind_ms`` and ``flagged`` of
            verdicts; ``counts`` as of the last message.
    """
    phases, spent_ms, behind_ms, flagged = list[tuple[int, int]](), list[float](), list[float](), list[bool]()
    counts = [0, 0, 0]
    with eitskin.subscribe_verified(endpoint, "all", frames=False, timeout_s=MODEL_TIMEOUT_S) as verdicts:
        while (state := verdicts.next_verified().state) != "ready":
            if state == "failed":
                raise eitskin.SkinError("the verifier cannot make a model of this sheet")
    print("ready", flush=True)
    try:
        while True:
            time.sleep(phase_s)
            begin_ns = time.perf_counter_ns()
            with eitskin.subscribe_verified(endpoint, "all", frames=False) as verdicts:
                end_ns = begin_ns + round(phase_s * 1e9)
                while (left_s := (end_ns - time.perf_counter_ns()) * 1e-9) > 0:
                    try:
                        found = verdicts.next_verified(left_s)
                    except eitskin.NoFrame:
                        break
                    counts = list(found.counts.values())
                    if found.verified:
                        spent_ms.append(found.spent_s * 1e3)
                        behind_ms.append((found.received_ns - found.host_ns["publish"]) * 1e-6)
                        flagged.append(bool(found.flagged))
            phases.append((begin_ns, time.perf_counter_ns()))
    except Stopped:
        np.savez(
            path, phases=np.array(phases, dtype=np.int64).reshape(-1, 2), spent_ms=spent_ms, behind_ms=behind_ms,
            flagged=np.array(flagged, dtype=np.bool_), counts=counts,
        )  # fmt: skip


def _turns(endpoint: str, path: str, phase_s: str) -> int:
    """Run the process that asks for verdicts."""
    raise_stopped_on_signals()
    try:
        take_turns(endpoint, float(phase_s), Path(path))
    except (eitskin.SkinError, Stopped) as error:
        print(f"{error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_turns(*sys.argv[2:]) if sys.argv[1:2] == [TURNS] else program(__doc__, add_arguments, run))
