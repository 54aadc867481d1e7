"""``eitskin bench electrodes``: failing electrodes, named from the frames, and what is left without them.

Rows of ``false alarms`` and of each kind of failure run through moving deformations and touches
(:mod:`eitskin_tools.bench.electrodes.detection`); rows of ``accuracy`` need ``--phantoms``
(:mod:`eitskin_tools.bench.electrodes.accuracy`); of ``gate`` say whether the gate is still right without electrodes
(:mod:`eitskin_tools.bench.electrodes.gate`); rows of ``drift`` how well a common factor is known, with and without a
cloud (:mod:`eitskin_tools.bench.electrodes.drift`); ``cost`` is CPU time. Rows are shown on stderr as each part ends.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from eitskin_tools.bench.harness import chosen, row_text, several
from eitskin_tools.command_line import files
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.threads import one_blas_thread

if TYPE_CHECKING:
    from eitskin.health.imputation import Consistency
    from eitskin.model.bundle import Bundle

PARTS: Final = ("detection", "gate", "accuracy", "drift", "cost")
"""What ``--only`` takes."""

NOISES: Final = ("N1", "N2", "N3")

Rows = list[dict[str, Any]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--bundle", type=files.bundle, help="bundle to use (default: the shipped one of unit labels)")
    parser.add_argument(
        "--phantoms", metavar="FILE", help="measure the accuracy left on these too: a file, paper_units or paper_mm"
    )
    parser.add_argument("--streams", type=int, default=4, metavar="N", help="streams of each kind (default 4)")
    parser.add_argument("--moments", type=int, default=12, metavar="N", help="solved moments of a stream (default 12)")
    parser.add_argument(
        "--noise", action="append", type=several(NOISES), metavar="NAME[,NAME]", help="of N1, N2, N3 (default N2)"
    )
    parser.add_argument("--snr-db", type=float, default=50.0, metavar="DB", help="signal to noise ratio (default 50)")
    parser.add_argument(
        "--only", action="append", type=several(PARTS), metavar="NAME[,NAME]", help=f"of {', '.join(PARTS)}"
    )
    parser.add_argument("--no-classical", action="store_true", help="leave the classical solvers' accuracy out")
    parser.add_argument("--quick", action="store_true", help="a thinned form")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.streams < 1 or arguments.moments < 2:
        raise UsageError("--streams must be at least 1 and --moments at least 2")
    parts = chosen(arguments.only, PARTS)
    if arguments.only and "accuracy" in parts and arguments.phantoms is None:
        raise UsageError("--only accuracy needs --phantoms FILE")
    one_blas_thread()
    rows = measure(arguments, parts)
    summary = _summary(rows)
    if arguments.json:
        print(json.dumps({"rows": rows, "summary": summary}))
    else:
        for row in [*rows, summary]:
            print(row_text(row))
    return 0


def measure(arguments: argparse.Namespace, parts: tuple[str, ...]) -> Rows:
    """Return every row that was asked for.

    Args:
        arguments: The options.
        parts: Of ``PARTS``.

    Raises:
        BundleError: The bundle says nothing of healthy frames.
    """
    from eitskin.errors import BundleError
    from eitskin.health.imputation import MISSING, Consistency
    from eitskin.model.bundle import default_path, load_bundle

    bundle = load_bundle(arguments.bundle or default_path("units"))
    arrays = bundle.consistency_arrays()
    if arrays is None:
        raise BundleError(f"{bundle.path}: telling failed electrodes is {MISSING}")
    consistency = Consistency.of(arrays)
    noises = tuple(name for part in arguments.noise or [("N2",)] for name in part)
    makers: dict[str, Callable[[], Rows]] = {
        "detection": lambda: _detection(arguments, consistency, noises),
        "gate": lambda: _gate(arguments, bundle, consistency, noises),
        "accuracy": lambda: _accuracy(arguments, bundle, consistency, noises),
        "drift": lambda: _drift(arguments, consistency),
        "cost": lambda: _cost(consistency),
    }
    rows: Rows = []
    for part in parts:
        start_s = time.process_time()
        found = makers[part]()
        for row in found:
            print(f"eitskin bench electrodes: {row_text(row)}", file=sys.stderr, flush=True)
        print(f"eitskin bench electrodes: {part}: {time.process_time() - start_s:.0f} CPU-s", file=sys.stderr)
        rows += found
    return rows


def _detection(arguments: argparse.Namespace, consistency: "Consistency", noises: tuple[Any, ...]) -> Rows:
    from eitskin_tools.bench.electrodes import detection
    from eitskin_tools.bench.electrodes.streams import flat_response, stream

    flat = flat_response()
    count, moments = (1, 3) if arguments.quick else (arguments.streams, arguments.moments)
    streams = [
        stream(family, number, moments, covering=covering)
        for family in ("A", "B")
        for covering in (False, True)
        for number in range(count)
    ]
    few, electrodes = (streams[:1], range(0, 16, 5)) if arguments.quick else (streams[:: max(count, 1)], range(16))
    rows: Rows = []
    for noise in noises:
        rows += detection.false_alarms(consistency, flat, streams, noise, arguments.snr_db)
        rows += detection.detection(consistency, flat, few, noise, arguments.snr_db, electrodes)
    return rows


def _gate(arguments: argparse.Namespace, bundle: "Bundle", consistency: "Consistency", noises: tuple[Any, ...]) -> Rows:
    from eitskin_tools.bench.electrodes.gate import honest

    arrays = bundle.gate_arrays()
    if arrays is None:
        return []
    bends, sets = (6, 2) if arguments.quick else (60, 12)
    return honest(arrays, consistency, noises, arguments.snr_db, bends=bends, most_sets=sets)


def _accuracy(
    arguments: argparse.Namespace, bundle: "Bundle", consistency: "Consistency", noises: tuple[Any, ...]
) -> Rows:
    if arguments.phantoms is None:
        return []
    from eitskin_sim.evaluation.harness import Conditions
    from eitskin_sim.scene.scene import load_phantoms
    from eitskin_tools.bench.electrodes.accuracy import SETS, accuracy

    phantoms = load_phantoms(files.find(arguments.phantoms, files.PHANTOMS))
    sets = 2 if arguments.quick else SETS
    classical = not (arguments.no_classical or arguments.quick)
    rows: Rows = []
    for noise in noises:
        conditions = Conditions(noise=noise, snr_db=arguments.snr_db)
        found = accuracy(phantoms, bundle, consistency, conditions, classical=classical, most_sets=sets)
        rows += [{"noise": noise, **row} for row in found]
    return rows


def _drift(arguments: argparse.Namespace, consistency: "Consistency") -> Rows:
    from eitskin_tools.bench.electrodes.drift import drifting

    return drifting(consistency, 4 if arguments.quick else 24)


def _cost(consistency: "Consistency") -> Rows:
    from eitskin_sim.solvers.operators import build_operators
    from eitskin_tools.bench.electrodes.accuracy import costs

    return costs(build_operators(), consistency)


def _summary(rows: Rows) -> dict[str, Any]:
    alarms = [row for row in rows if row["what"] == "false alarms"]
    named = [row for row in rows if "named_in_time" in row]
    left = [row for row in rows if row["what"] == "accuracy" and row["remedy"] == "imputed" and row["lost"] == 1]
    gates = [row for row in rows if row["what"] == "gate" and row["lost"] == 1 and "runtime" in row["rows"]]
    return {
        "healthy_frames": sum(row["frames"] for row in alarms),
        "named_while_healthy": sum(row["named"] for row in alarms),
        "named_in_time": {f"{row['what']}, {row['noise']}": row["named_in_time"] for row in named},
        "frames_max": max((row["frames_max"] or 0 for row in named), default=None),
        "cc_of_intact_one_electrode_lost": {row["noise"]: row["of_intact"] for row in left},
        "cc_of_intact_worst_electrode_lost": {row["noise"]: row["worst_of_intact"] for row in left},
        "gate_false_alarms_one_electrode_lost": {row["noise"]: row["false_alarms"] for row in gates},
    }
