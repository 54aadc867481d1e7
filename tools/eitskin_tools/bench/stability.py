"""``eitskin bench stability``: what breaks a skin, at which level, and why; a row a sweep and solver.

The sweeps are those of :mod:`eitskin_tools.stress`. Each row has the accuracy without the disturbance and at its worst,
the level at which a tenth of it is lost (interpolated), the level at which it breaks, and what explains that, with the
figure. Maps go through the runtime's pipeline, and each one that is published is looked at: the summary counts those
that are not finite, or not from 0 to 1. It exits 1 if there is one, or if an input escaped.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from eitskin_tools.stress.rows import Curve, Row
    from eitskin_tools.stress.sweep import Effort

FAMILIES: Final = ("noise", "frontend", "material", "shape", "meshes", "precision", "int8", "inputs", "repeat")
"""What ``--only`` takes."""

SWEPT: Final = FAMILIES[:5]
"""The families that are sweeps of samples through every solver."""

WORST_STEPS: Final = {"quick": 200, "full": 3000}
"""Steps of the search for the worst int8 input, from each scene."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--quick", action="store_true", help="thinned: under a minute of one core")
    parser.add_argument("--only", action="append", choices=FAMILIES, help="only this family of sweeps; repeatable")
    parser.add_argument("--bundle", type=Path, metavar="FILE", help="bundle to stress (default: both shipped ones)")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the curves into this PNG file")
    parser.add_argument("--json", action="store_true", help="print one JSON object: rows, curves, summary")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print."""
    from eitskin.bundle import default_path
    from eitskin_tools.stress.sweep import FULL, QUICK

    bundles = [arguments.bundle] if arguments.bundle else [default_path("units"), default_path("area")]
    effort = QUICK if arguments.quick else FULL
    start = time.process_time()
    rows, curves, summary = table(bundles, effort, tuple(arguments.only or FAMILIES), quick=arguments.quick)
    summary["cpu_s"] = round(time.process_time() - start, 1)
    if arguments.plot:
        from eitskin_tools.stress.draw import draw_curves

        draw_curves(curves, arguments.plot)
    if arguments.json:
        print(json.dumps({"rows": rows, "curves": [_points(curve) for curve in curves], "summary": summary}))
    else:
        _print(rows, summary)
    return 0 if is_sound(summary) else 1


def is_sound(summary: dict[str, Any]) -> bool:
    """Return whether nothing absurd was published and nothing escaped."""
    faults = ("published_not_finite", "published_out_of_range", "published_saturated_unmarked", "escaped")
    return not any(summary[name] for name in faults)


def table(
    bundles: list[Path], effort: "Effort", families: tuple[str, ...] = FAMILIES, *, quick: bool = True
) -> "tuple[list[Row], list[Curve], dict[str, Any]]":
    """Return the rows, the curves behind them, and the summary.

    Args:
        bundles: The first is stressed by every family, others by the sweeps (noise alone where it is quick).
        effort: How much of each sweep.
        families: Of ``FAMILIES``.
        quick: Short searches.
    """
    from eitskin.bundle import load_bundle
    from eitskin_tools.stress.samples import samples
    from eitskin_tools.stress.solvers import Subjects
    from eitskin_tools.stress.sweep import run_stress
    from eitskin_tools.stress.tally import Tally

    tally = Tally()
    rows: list[Row] = []
    curves: list[Curve] = []
    for number, path in enumerate(bundles):
        subjects = Subjects(load_bundle(path), tally)
        drawn = samples(subjects.labels, effort.samples, effort.element_size_mm)
        for family in [name for name in SWEPT if name in families and (number == 0 or name == "noise" or not quick)]:
            for stress in _stresses(family):
                print(f"eitskin bench stability: {subjects.labels}: {stress.name}", file=sys.stderr)
                for row, curve in run_stress(stress, subjects, drawn, effort):
                    rows.append({"family": family, **row})
                    curves.append(curve)
        if number == 0:
            rows += _other_rows(subjects, drawn, effort, families, quick=quick)
    return rows, curves, _summary(rows, tally.summary(), tally.escaped)


def _stresses(family: str) -> list[Any]:
    import importlib

    stresses: Callable[[], list[Any]] = importlib.import_module(f"eitskin_tools.stress.{family}").stresses
    return stresses()


def _other_rows(subjects: Any, drawn: Any, effort: "Effort", families: tuple[str, ...], *, quick: bool) -> "list[Row]":
    """Return the rows that are no sweeps of samples."""
    from eitskin_tools.stress.constant import constant_rows
    from eitskin_tools.stress.inputs import input_rows
    from eitskin_tools.stress.meshes import triangle_rows
    from eitskin_tools.stress.precision import precision_rows
    from eitskin_tools.stress.repeat import repeat_rows
    from eitskin_tools.stress.worst import worst_row

    stream, bundle = subjects.plain, subjects.bundle
    makers: dict[str, Callable[[], list[Row]]] = {
        "shape": lambda: constant_rows(subjects, drawn),
        "meshes": triangle_rows,
        "precision": lambda: precision_rows(drawn[0], max(effort.levels, 7)),
        "int8": lambda: [worst_row(stream, drawn, WORST_STEPS["quick" if quick else "full"])],
        "inputs": lambda: input_rows(bundle, drawn[0], subjects.tally),
        "repeat": lambda: repeat_rows(bundle, drawn),
    }
    if "vd2t-int8" not in stream.engines:
        del makers["int8"]
    rows = []
    for family, make in makers.items():
        if family in families:
            print(f"eitskin bench stability: {family}", file=sys.stderr)
            rows += [{"family": family, **row} for row in make()]
    return rows


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
    from eitskin_tools.stress.rows import rounded

    return {
        "sweep": curve.sweep,
        "solver": curve.solver,
        "unit": curve.unit,
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
        figures = [f"{name} {row[key]:g}" for key, name in _FIGURES.items() if isinstance(row.get(key), int | float)]
        print(f"  {row['solver']:18}{'  '.join(figures)}\n    {row['why']}")
    print()
    for name, value in summary.items():
        print(f"{name}: {value}")


_FIGURES: Final = {
    "unstressed": "unstressed",
    "worst": "worst",
    "degrades_10pct_at": "loses a tenth at",
    "breaks_at": "breaks at",
    "withheld": "withheld",
    "refused": "refused",
    "escaped": "escaped",
}
