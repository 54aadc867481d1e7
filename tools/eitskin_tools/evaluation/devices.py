"""Trials on mismatched devices, and the table by mismatch."""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from eitskin_sim.evaluation.devices.mismatch import Row, lab_rows, load_rows, random_rows
from eitskin_sim.evaluation.devices.runs import Plan, Trial, drawn_trials, run_rows
from eitskin_sim.evaluation.harness import SOLVERS, Conditions
from eitskin_sim.scene.scene import load_phantoms
from eitskin_tools.command_line import files
from eitskin_tools.evaluation.drift_removed import DriftRemoved
from eitskin_tools.evaluation.gate_judge import judge_of
from eitskin_tools.evaluation.solvers import Named, Progress, Request, bundle_for, named

KINDS: Final = {
    "mm": "paper_mm, mean / worst",
    "units": "paper_units",
    "single": "single, CC, rms mm",
    "press04": "press 0.4, CC, rms mm",
    "press06": "press 0.6, CC, rms mm",
}
"""Trials by name, and the head of their column."""


def rows_of(name: str) -> list[Row]:
    """Return the mismatches of ``--devices``: ``lab``, ``random``, or those of a file or of a shipped list.

    Raises:
        ValueError, OSError: The file is not one of mismatches.
    """
    drawn = {"lab": lab_rows, "random": random_rows}.get(name)
    return drawn() if drawn else load_rows(files.find(name, files.MISMATCHES))


def trials_of(kinds: Sequence[str], deformations: int, each: int) -> list[Trial]:
    """Return trials by name.

    Raises:
        ValueError: There is none of a name, or none at all.
    """
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown or not kinds:
        raise ValueError(f"--trials {','.join(kinds)}: expected some of {', '.join(KINDS)}")
    found = {one.name: one for one in drawn_trials(deformations, each)}
    for kind in ("mm", "units"):
        if kind in kinds:
            found[kind] = Trial(kind, tuple(load_phantoms(files.find(f"paper_{kind}", files.PHANTOMS))))
    return [found[kind] for kind in KINDS if kind in kinds]


def evaluate_devices(
    rows: Sequence[Row],
    kinds: Sequence[Trial],
    request: Request,
    plan: Plan,
    progress: Progress | None = None,
    drift: str = "left",
) -> dict[str, Any]:
    """Return the object that ``eitskin evaluate --devices --json`` prints.

    Args:
        rows: Names and mismatches.
        kinds: Trials.
        request: Solver, reference ("pre" or "predicted"), bundle; a bundle serves the trials of its labels alone.
        plan: Draws, seed, noise.
        progress: Called with devices done and all devices.
        drift: "left" in, or how the runtime meets it (:mod:`eitskin_tools.evaluation.drift_removed`).

    Raises:
        ValueError: The request needs the untouched voltages at every shape.
    """
    if request.reference == "post" or request.prediction == "true":
        raise ValueError("--devices knows no untouched voltages of a bent device; leave --reference post and true out")
    reference = request.reference or ("predicted" if request.name in SOLVERS else "pre")
    solvers: dict[str, Named] = {}
    judges, bundles = {}, {}
    followers: dict[str, DriftRemoved] = {}
    for kind in kinds:
        bundle = bundle_for(request, kind.labels, "lowering" if kind.lowering else "raising")
        bundles[kind.name] = bundle.id
        one = Request(request.name, reference, bundle.path, request.prediction)
        told = Conditions(plan.noise, plan.snr_db)
        solvers[kind.name] = named(one, kind.labels, plan.skin, conditions=told)
        judges[kind.name] = judge_of(bundle)
        if drift != "left":
            followers[kind.name] = DriftRemoved(bundle, drift)
    runs = {name: one.run for name, one in solvers.items()}
    found = run_rows(rows, kinds, runs, judges, plan, progress, followers or None)
    return {
        "solver": request.name,
        "noise": plan.noise,
        "snr_db": plan.snr_db,
        "draws": plan.draws,
        "seed": plan.seed,
        "reference": reference,
        "drift": drift,
        "bundles": bundles,
        "rows": found,
    }


def table(found: dict[str, Any]) -> str:
    """Return the table by mismatch as Markdown."""
    rows = found["rows"]
    kinds = [kind for kind in KINDS if kind in rows[0]]
    lines = [
        f"| mismatch | {' | '.join(KINDS[kind] for kind in kinds)} |",
        f"|{'---|' * (len(kinds) + 1)}",
    ]
    for row in rows:
        cells = [_CELLS[kind](row[kind]) if row[kind] else "-" for kind in kinds]
        lines.append(f"| {row['name']} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _worst(one: dict[str, Any]) -> str:
    return f"{one['cc']:.3f} / {one['cc_worst']:.3f}"


def _mean(one: dict[str, Any]) -> str:
    return f"{one['cc']:.3f}"


def _touch(one: dict[str, Any]) -> str:
    if one["missed"] == 1.0:
        return f"{one['cc']:.3f}, all missed"
    away = one["localisation_rms_mm"]
    cells = [f"{one['cc']:.3f}", "-" if away is None else f"{away:.2f}"]
    if one["missed"]:
        cells.append(f"missed {np.ceil(100 * one['missed']):.0f} %")
    return ", ".join(cells)


_CELLS: Final[dict[str, Callable[[dict[str, Any]], str]]] = {
    "mm": _worst, "units": _mean, "single": _touch, "press04": _touch, "press06": _touch,
}  # fmt: skip
