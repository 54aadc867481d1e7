"""``eitskin bench electrodes``: failing electrodes, named from the frames, and what is left without them.

Rows of ``false alarms`` and of each kind of failure run through moving deformations and touches
(:mod:`eitskin_tools.failing`); rows of ``accuracy`` need ``--phantoms`` (:mod:`eitskin_tools.lost`); rows of ``drift``
say how well a common factor is known, with and without a scan (:mod:`eitskin_tools.drifting`); ``cost`` is CPU time.
"""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

from eitskin_tools.cli import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--bundle", type=Path, help="bundle to use (default: the shipped one of unit labels)")
    parser.add_argument("--phantoms", type=Path, metavar="FILE", help="measure the accuracy left on these too")
    parser.add_argument("--streams", type=int, default=4, metavar="N", help="streams of each kind (default 4)")
    parser.add_argument("--moments", type=int, default=12, metavar="N", help="solved moments of a stream (default 12)")
    parser.add_argument("--noise", default="N2", choices=("N1", "N2", "N3"), help="kind of noise (default N2)")
    parser.add_argument("--snr-db", type=float, default=50.0, metavar="DB", help="signal to noise ratio (default 50)")
    parser.add_argument("--only", choices=("detection", "accuracy", "drift", "cost"), help="measure this part alone")
    parser.add_argument("--no-classical", action="store_true", help="leave the classical solvers' accuracy out")
    parser.add_argument("--quick", action="store_true", help="a thinned form")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.streams < 1 or arguments.moments < 2:
        raise UsageError("--streams must be at least 1 and --moments at least 2")
    if arguments.only == "accuracy" and arguments.phantoms is None:
        raise UsageError("--only accuracy needs --phantoms FILE")
    if "numpy" not in sys.modules:
        os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
    rows = measure(arguments)
    summary = _summary(rows)
    if arguments.json:
        print(json.dumps({"rows": rows, "summary": summary}))
    else:
        for row in [*rows, summary]:
            print("  ".join(f"{name} {value}" for name, value in row.items()))
    return 0


def measure(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Return every row that was asked for.

    Raises:
        BundleError: The bundle says nothing of healthy frames.
    """
    from eitskin.bundle import default_path, load_bundle
    from eitskin.errors import BundleError
    from eitskin.imputation import MISSING, Consistency

    bundle = load_bundle(arguments.bundle or default_path("units"))
    arrays = bundle.consistency_arrays()
    if arrays is None:
        raise BundleError(f"{bundle.path}: telling failed electrodes is {MISSING}")
    consistency = Consistency.of(arrays)
    wanted = (arguments.only,) if arguments.only else ("detection", "accuracy", "drift", "cost")
    rows: list[dict[str, Any]] = []
    if "detection" in wanted:
        rows += _detection(arguments, consistency)
    if "accuracy" in wanted and arguments.phantoms is not None:
        from eitskin_sim.evaluate import Conditions
        from eitskin_sim.scene import load_phantoms
        from eitskin_tools.lost import SETS, accuracy

        conditions = Conditions(noise=arguments.noise, snr_db=arguments.snr_db)
        phantoms = load_phantoms(arguments.phantoms)
        sets = 2 if arguments.quick else SETS
        classical = not (arguments.no_classical or arguments.quick)
        rows += accuracy(phantoms, bundle, consistency, conditions, classical=classical, most_sets=sets)
    if "drift" in wanted:
        from eitskin_tools.drifting import drifting

        rows += drifting(consistency, 4 if arguments.quick else 24)
    if "cost" in wanted:
        from eitskin_sim.solvers.operators import build_operators
        from eitskin_tools.lost import costs

        rows += costs(build_operators(), consistency)
    return rows


def _detection(arguments: argparse.Namespace, consistency: Any) -> list[dict[str, Any]]:
    from eitskin_tools import failing

    flat = failing.flat_response()
    count, moments = (1, 3) if arguments.quick else (arguments.streams, arguments.moments)
    streams = [
        failing.stream(family, number, moments, covering=covering)
        for family in ("A", "B")
        for covering in (False, True)
        for number in range(count)
    ]
    rows = failing.false_alarms(consistency, flat, streams, arguments.noise, arguments.snr_db)
    chosen, electrodes = (streams[:1], range(0, 16, 5)) if arguments.quick else (streams[:: max(count, 1)], range(16))
    return rows + failing.detection(consistency, flat, chosen, arguments.noise, arguments.snr_db, electrodes)


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    alarms = [row for row in rows if row["what"] == "false alarms"]
    named = [row for row in rows if "named_in_time" in row]
    left = [row for row in rows if row["what"] == "accuracy" and row["remedy"] == "imputed" and row["lost"] == 1]
    return {
        "healthy_frames": sum(row["frames"] for row in alarms),
        "named_while_healthy": sum(row["named"] for row in alarms),
        "named_in_time": {row["what"]: row["named_in_time"] for row in named},
        "frames_max": max((row["frames_max"] or 0 for row in named), default=None),
        "cc_of_intact_one_electrode_lost": left[0]["of_intact"] if left else None,
        "cc_of_intact_worst_electrode_lost": left[0]["worst_of_intact"] if left else None,
    }
