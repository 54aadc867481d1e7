"""Trials on mismatched devices, and the table by mismatch."""

from collections.abc import Callable, Sequence
from typing import Any, Final, Literal

import numpy as np

from eitskin_proto.files.plain import quoted
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.evaluation.device_runs import Plan, Trial, drawn_trials, run_rows, sets_of_touches
from eitskin_sim.evaluation.harness import Conditions
from eitskin_sim.evaluation.mismatch import Row, lab_rows, load_rows, random_rows
from eitskin_sim.scene.scene import SceneError, load_phantoms
from eitskin_tools.command_line import files
from eitskin_tools.evaluation.solvers import Named, Progress, Request, bundle_on, is_deployed, judge_of, named

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


def meant(skin: Skin) -> Skin:
    """Return what devices are drawn around, whose solver assumes a skin: that skin, if it is no device itself.

    Raises:
        ValueError: It was calibrated from another skin than those that have the paper's sheet.
    """
    if not skin.calibrated_from:
        return skin
    if skin.grid_id == PAPER.grid_id:
        return PAPER
    raise ValueError(f"skin {skin.name!r} is one calibrated device; name the skin.toml that it was calibrated from")


def trials_of(kinds: Sequence[str], deformations: int, each: int, skin: Skin = PAPER) -> list[Trial]:
    """Return trials by name, on any skin; of the paper's sheet ``mm`` and ``units`` are the paper's phantoms.

    Raises:
        ValueError: There is none of a name, or none at all.
    """
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown or not kinds:
        raise ValueError(f"--trials {','.join(kinds)}: expected some of {', '.join(KINDS)}")
    found = {one.name: one for one in drawn_trials(deformations, each, skin)}
    labels: dict[str, Literal["units", "area"]] = {"mm": "area", "units": "units"}
    for kind, pixels in labels.items():
        if kind in kinds and skin.grid_id == PAPER.grid_id:
            found[kind] = Trial(kind, tuple(load_phantoms(files.find(f"paper_{kind}", files.PHANTOMS), skin)))
        elif kind in kinds:
            found[kind] = Trial(kind, sets_of_touches(pixels, deformations, each, skin))
    return [found[kind] for kind in KINDS if kind in kinds]


def evaluate_devices(
    rows: Sequence[Row],
    kinds: Sequence[Trial],
    request: Request,
    plan: Plan,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Return the object that ``eitskin evaluate --devices --json`` prints.

    Args:
        rows: Names and mismatches.
        kinds: Trials.
        request: Solver, reference ("pre" or "predicted"), bundle; a bundle serves the trials of its labels alone.
        plan: Draws, seed, noise.
        progress: Called with devices done and all devices.

    Raises:
        ValueError: The request needs the untouched voltages at every shape, or a row is of another sheet.
    """
    if request.reference == "post":
        raise ValueError("--devices has no untouched voltages of a bent device: leave out --reference post")
    for name, mismatch in rows:
        try:
            if mismatch is not None:
                mismatch.require(plan.meant)
        except SceneError as error:
            raise SceneError(f"mismatch {quoted(name)}: {error}") from error
    reference = request.reference or ("pre" if is_deployed(request) else "predicted")
    solvers: dict[str, Named] = {}
    judges, bundles = {}, {}
    for kind in kinds:
        touches: TouchKind = "lower" if kind.lowering else "raise"
        bundle = bundle_on(request, kind.labels, touches, plan.skin)
        bundles[kind.name] = None if bundle is None else bundle.id
        one = Request(request.name, reference, None if bundle is None else bundle.path, request.prediction)
        told = Conditions(plan.noise, plan.snr_db)
        solvers[kind.name] = named(one, kind.labels, plan.skin, touches, told)
        judges[kind.name] = judge_of(bundle)
    runs = {name: one.run for name, one in solvers.items()}
    found = run_rows(rows, kinds, runs, judges, plan, progress)
    return {
        "solver": request.name,
        "noise": plan.noise,
        "snr_db": plan.snr_db,
        "draws": plan.draws,
        "seed": plan.seed,
        "reference": reference,
        "bundles": bundles,
        "skin": plan.meant.name,
        "phantoms": "paper" if plan.meant.grid_id == PAPER.grid_id else "drawn",
        "rows": found,
    }


def table(found: dict[str, Any]) -> str:
    """Return the table by mismatch as Markdown."""
    rows = found["rows"]
    kinds = [kind for kind in KINDS if kind in rows[0]]
    heads = [KINDS[kind] if found["phantoms"] == "paper" else KINDS[kind].removeprefix("paper_") for kind in kinds]
    lines = [
        f"| mismatch | {' | '.join(heads)} |",
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
