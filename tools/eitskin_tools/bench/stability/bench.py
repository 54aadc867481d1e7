"""``eitskin bench stability``: what breaks a skin, at which level, and why; a row a sweep and solver.

The sweeps are those of :mod:`eitskin_tools.bench.stability`. Each row has the accuracy without the disturbance and at
its worst, the level at which a tenth of it is lost (interpolated), the level at which it breaks, and what explains
that, with the figure. Maps go through the runtime's pipeline, and each one that is published is looked at: the summary
counts those that are not finite, or not from 0 to 1. It exits 1 if there is one, or if an input escaped.

Rows are shown on stderr as they are found, with the time left. Ctrl-C ends the run; what was found until then is
printed as a whole run would be, and the summary says how many jobs are missing.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from eitskin_tools.bench.harness import chosen, several
from eitskin_tools.command_line import files
from eitskin_tools.processes.threads import one_blas_thread

if TYPE_CHECKING:
    from eitskin_tools.bench.stability.harness.rows import Curve, Row
    from eitskin_tools.bench.stability.harness.sweep import Effort

FAMILIES: Final = (
    "noise", "frontend", "material", "shape", "meshes", "precision", "int8", "inputs", "denormals", "repeat"
)  # fmt: skip
"""What ``--only`` takes."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--quick", action="store_true", help="thinned: under a minute of one core")
    parser.add_argument(
        "--only", action="append", type=several(FAMILIES), metavar="NAME[,NAME]", help=f"of {', '.join(FAMILIES)}"
    )
    parser.add_argument(
        "--bundle", type=files.bundle, metavar="FILE", help="bundle to stress (default: the shipped units and free)"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the curves into this PNG file")
    parser.add_argument("--json", action="store_true", help="print one JSON object: rows, curves, summary")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print."""
    one_blas_thread()
    from eitskin.model.bundle import default_path
    from eitskin_tools.bench.stability.harness.sweep import FULL, QUICK

    if arguments.plot:
        files.picture(arguments.plot)
    bundles = [arguments.bundle] if arguments.bundle else [default_path("units"), default_path("area")]
    effort = QUICK if arguments.quick else FULL
    start = time.process_time()
    rows, curves, summary = table(
        bundles, effort, chosen(arguments.only, FAMILIES), quick=arguments.quick, say=_to_stderr
    )
    summary["cpu_s"] = round(time.process_time() - start, 1)
    if arguments.plot:
        from eitskin_tools.bench.stability.draw import draw_curves

        draw_curves(curves, arguments.plot)
    if arguments.json:
        print(json.dumps({"rows": rows, "curves": [_points(curve) for curve in curves], "summary": summary}))
    else:
        _print(rows, summary)
    return 0 if is_sound(summary) and not summary["jobs_left_out"] else 1


def is_sound(summary: dict[str, Any]) -> bool:
    """Return whether nothing absurd was published and nothing escaped."""
    faults = ("published_not_finite", "published_out_of_range", "published_saturated_unmarked", "escaped")
    return not any(summary[name] for name in faults)


def table(
    bundles: list[Path],
    effort: "Effort",
    families: tuple[str, ...] = FAMILIES,
    *,
    quick: bool = True,
    say: Callable[[str], None] = lambda line: None,
) -> "tuple[list[Row], list[Curve], dict[str, Any]]":
    """Return the rows, the curves behind them, and the summary; of the jobs before a Ctrl-C, if there is one.

    Args:
        bundles: The first is stressed by every family, others by the sweeps (noise alone where it is quick).
        effort: How much of each sweep.
        families: Of ``FAMILIES``.
        quick: Short searches.
        say: Takes a line for people on each row, and on the time left.
    """
    from eitskin_tools.bench.stability.harness.tally import Tally
    from eitskin_tools.bench.stability.jobs import Progress, jobs_of

    tally = Tally()
    rows: list[Row] = []
    curves: list[Curve] = []
    jobs = list(jobs_of(bundles, effort, families, tally, quick=quick))
    progress = Progress(jobs)
    try:
        for job in jobs:
            say(f"{job.family}: {job.name}")
            for row, curve in job.run():
                rows.append({"family": job.family, **row})
                curves += [curve] if curve is not None else []
                say(f"  {_line(row)}")
            say(progress.step())
    except KeyboardInterrupt:
        say(f"stopped: {len(jobs) - progress.done} of {len(jobs)} jobs are left out")
    summary = _summary(rows, tally.summary(), tally.escaped)
    return rows, curves, {**summary, "jobs": len(jobs), "jobs_left_out": len(jobs) - progress.done}


def _to_stderr(line: str) -> None:
    print(f"eitskin bench stability: {line}", file=sys.stderr, flush=True)


def _summary(rows: "list[Row]", counts: dict[str, Any], escaped: list[str]) -> dict[str, Any]:
    broken = [row for row in rows if row.get("breaks_at") is not None]
    return {
        "rows": len(rows),
        "broken": len(broken),
        "broken_unexplained": sum(not row.get("why") for row in broken),
        **counts,
        "first_escaped": escaped[0] if escaped else "",
    }


def _points(curve: "Curve") -> dict[str, Any]:
    from eitskin_tools.bench.stability.harness.rows import rounded

    return {
        "sweep": curve.sweep,
        "solver": curve.solver,
        "unit": curve.unit,
        "unstressed": rounded(curve.unstressed),
        "logarithmic": curve.logarithmic,
        "levels": [point.level for point in curve.points],
        "accuracy": [rounded(point.accuracy) for point in curve.points],
        "map_rms": [rounded(point.map_rms) for point in curve.points],
        "withheld": [rounded(point.withheld) for point in curve.points],
    }


def _print(rows: "list[Row]", summary: dict[str, Any]) -> None:
    last = ""
    for row in rows:
        if row["sweep"] != last:
            last = row["sweep"]
            print(f"\n{last} ({row['unit']})")
        print(f"  {_line(row)}\n    {row['why']}")
    print()
    for name, value in summary.items():
        print(f"{name}: {value}")


def _line(row: "Row") -> str:
    figures = [f"{name} {row[key]:g}" for key, name in _FIGURES.items() if isinstance(row.get(key), int | float)]
    return f"{row['solver']:18}{'  '.join(figures)}"


_FIGURES: Final = {
    "unstressed": "unstressed",
    "worst": "worst",
    "unguarded": "unguarded",
    "degrades_10pct_at": "loses a tenth at",
    "breaks_at": "breaks at",
    "withheld": "withheld",
    "refused": "refused",
    "escaped": "escaped",
}
