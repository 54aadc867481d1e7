"""``eitskin bench verify``: what the verifier of touches survives, and whether its p-values keep their word.

Sets of units at deformations that no network has seen, on devices that differ from the nominal one, are solved on a
mesh of their own; the network answers, and the verifier starts from there. A row says how many sets came out exact, how
many wrong ones were not flagged, and how many right ones were. Times are of the processor, one core.
"""

import argparse
import json
from typing import Any

from eitskin_tools.errors import UsageError
from eitskin_tools.processes.threads import one_blas_thread


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--deformations", type=int, default=10, metavar="N", help="of family A (default 10)")
    parser.add_argument("--each", type=int, default=5, metavar="N", help="touch sets at each of them (default 5)")
    parser.add_argument("--budget-ms", type=float, default=20.0, metavar="T", help="for each frame (default 20)")
    parser.add_argument("--only", metavar="TEXT", help="rows whose name has this in it")
    parser.add_argument(
        "--sets",
        type=int,
        default=50,
        metavar="N",
        help="sets that p is counted on, 20 draws each (default 50; 0: none)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    one_blas_thread()
    from eitskin_tools.bench.verify.conditions import conditions
    from eitskin_tools.bench.verify.maps import measure
    from eitskin_tools.bench.verify.matched import candidates, matched

    if arguments.deformations < 1 or arguments.each < 1 or arguments.sets < 0 or not arguments.budget_ms >= 0.0:
        raise UsageError("--deformations and --each must be at least 1, --sets and --budget-ms at least 0")
    chosen = [one for one in conditions() if arguments.only is None or arguments.only in one.name]
    if not chosen:
        known = ", ".join(one.name for one in conditions())
        raise UsageError(f"--only {arguments.only!r}: expected a part of one of: {known}")
    rows = measure(chosen, arguments.deformations, arguments.each, 1e-3 * arguments.budget_ms)
    summary = {
        "maps": sum(row["maps"] for row in rows),
        "wrong_unflagged": sum(row["wrong_unflagged"] for row in rows),
    }
    stated = matched(arguments.sets) if arguments.sets else []
    steps = candidates() if arguments.sets else []
    if arguments.json:
        print(json.dumps({"rows": rows + stated + steps, "summary": summary}))
    else:
        print(table(rows, stated, steps))
    return 0


def table(rows: list[dict[str, Any]], stated: list[dict[str, Any]], steps: list[dict[str, Any]]) -> str:
    """Return the tables as Markdown."""
    lines = [
        "| condition | maps | network exact | exact | wrong, unflagged | right, flagged | chi-squared | ms p50 / p95 |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['what']} | {row['maps']} | {_percent(row['network_exact'])} | {_percent(row['exact'])} "
        f"| {row['wrong_unflagged']} of {row['wrong']} | {row['right_flagged']} of {row['maps'] - row['wrong']} "
        f"| {row['chi_squared_median']:.0f} | {row['cpu_ms_median']:.1f} / {row['cpu_ms_p95']:.1f} |"
        for row in rows
    ]
    if stated:
        lines += ["", "| p | stated | found | +- |", "|---|---|---|---|"]
        lines += [f"| {one['what']} | {one['stated']:g} | {one['found']:.4f} | {one['error']:.4f} |" for one in stated]
    if steps:
        lines += ["", "| step | us | a set alone, us | model, MB |", "|---|---|---|---|"]
        lines += [
            f"| {one['what']} | {one['cpu_us']:.0f} | {one['set_cpu_us']:.0f} | {one['model_MB']:.1f} |"
            for one in steps
        ]
    return "\n".join(lines)


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"
