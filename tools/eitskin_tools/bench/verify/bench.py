"""``eitskin bench verify``: what the verifier of touches survives, and whether its p-values keep their word.

Touches at deformations that no network has seen, on devices that differ from the nominal one, are solved on a mesh of
their own; the network answers, and the verifier starts from there. A row says how many answers came out right, how many
wrong ones were not flagged, and how many right ones were. Rows are shown on stderr as they are found; p's calibration
and JSON come at the end. Times are of the processor, one core.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from eitskin_tools.command_line import files
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.threads import one_blas_thread

Row = dict[str, Any]

CALIBRATION = "calibration of p"
"""What ``--only`` calls the table of p."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--deformations", type=int, default=6, metavar="N", help="of family A (default 6)")
    parser.add_argument("--each", type=int, default=4, metavar="N", help="touch sets at each of them (default 4)")
    parser.add_argument(
        "--budget-ms", type=float, metavar="T", help="for each frame of touched units (default: the verifier's own)"
    )
    parser.add_argument(
        "--only", action="append", metavar="ROW", help="rows whose name has this in it; may be given again"
    )
    parser.add_argument(
        "--sets",
        type=int,
        default=50,
        metavar="N",
        help="sets that p is counted on, 20 draws each (default 50; 0: none)",
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw how p keeps its word")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    one_blas_thread()
    if (
        arguments.deformations < 1
        or arguments.each < 1
        or arguments.sets < 0
        or not (arguments.budget_ms or 0.0) >= 0.0
    ):
        raise UsageError("--deformations and --each must be at least 1, --sets and --budget-ms at least 0")
    if arguments.plot is not None:
        files.picture(arguments.plot)
    from eitskin_tools.bench.verify.printed import tables

    units, anywhere = _rows(arguments, _chosen(arguments.only))
    stated = _calibration(arguments, units)
    if arguments.json:
        every = [*units, *anywhere]
        summary = {key: sum(row[key] for row in every) for key in ("maps", "wrong", "wrong_unflagged")}
        print(json.dumps({"rows": every + stated, "summary": summary}))
    else:
        print(tables(units, anywhere, stated))
    return 0


def _chosen(only: list[str] | None) -> set[str]:
    """Return the names of the rows that were asked for.

    Raises:
        UsageError: There is none.
    """
    from eitskin_tools.bench.verify.conditions import anywhere_conditions, unit_conditions

    units, anywhere = unit_conditions(), anywhere_conditions()
    known = [*(one.name for one in units), *(one.name for one in anywhere), CALIBRATION]
    found = {name for name in known if not only or any(text in name for text in only)}
    if not found:
        texts = " ".join(repr(text) for text in only or ())
        raise UsageError(f"--only {texts}: expected a part of one of: {', '.join(known)}")
    return found


def _rows(arguments: argparse.Namespace, chosen: set[str]) -> tuple[list[Row], list[Row]]:
    """Return the rows of touched units and those of touches anywhere, each shown as it is found."""
    from eitskin_tools.bench.verify.anywhere import row
    from eitskin_tools.bench.verify.conditions import anywhere_conditions, unit_conditions
    from eitskin_tools.bench.verify.printed import anywhere_line, units_line
    from eitskin_tools.bench.verify.units import Units

    units: list[Row] = []
    anywhere: list[Row] = []
    measured: Units | None = None
    budget_s = None if arguments.budget_ms is None else 1e-3 * arguments.budget_ms
    for condition in unit_conditions():
        if condition.name in chosen:
            measured = measured or Units(arguments.deformations, arguments.each, budget_s)
            start = time.process_time()
            units.append(measured.row(condition))
            _say(units_line(units[-1]), start)
    for place in anywhere_conditions():
        if place.name in chosen:
            start = time.process_time()
            anywhere.append(row(place, arguments.deformations, arguments.each))
            _say(anywhere_line(anywhere[-1]), start)
    return units, anywhere


def _calibration(arguments: argparse.Namespace, units: list[Row]) -> list[Row]:
    """Return how p keeps its word; nothing if it was not asked for."""
    from eitskin_tools.bench.verify.matched import matched, of_rows

    if CALIBRATION not in _chosen(arguments.only) or not arguments.sets:
        return []
    start = time.process_time()
    stated = matched(arguments.sets) + of_rows(units)
    _say(CALIBRATION, start)
    if arguments.plot is not None:
        from eitskin_tools.bench.verify.plot import draw

        draw(arguments.plot, stated)
    return stated


def _say(line: str, start_s: float) -> None:
    print(f"eitskin bench verify: {line} {time.process_time() - start_s:.0f} CPU-s", file=sys.stderr, flush=True)
