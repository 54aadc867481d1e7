"""``eitskin bench verify``: how often the verifier of touches is right, and whether its p-values are calibrated.

Touches at deformations that no network has seen, on devices that differ from the nominal one, are solved on a mesh of
their own. The network answers, and the verifier starts from its map. A row counts the right answers, the wrong ones
that were not flagged, and the right ones that were. Rows appear on stderr as they are found; the calibration of p and
the JSON object come last. Times are CPU times of one core.
"""

import argparse
import time
from dataclasses import replace
from math import sqrt
from typing import Final, Literal

import numpy as np

from eitskin_proto.sensor.row_gaussian import RowGaussian, rows_of
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.evaluation import trials
from eitskin_sim.evaluation.harness import Case, Run, Sheet
from eitskin_sim.evaluation.metrics import MAX_MATCH_DISTANCE_MM, Score, lost_mm, score
from eitskin_sim.evaluation.mismatch import IDEAL
from eitskin_sim.evaluation.truth import truth_map
from eitskin_sim.measurement.consistency import RowImputation
from eitskin_sim.measurement.noise import NOISES, add_noise
from eitskin_sim.scene.touch_table import RECTANGLE
from eitskin_sim.verification.residual import Noise, Whitener
from eitskin_sim.verification.sheet_model import model_of_cloud
from eitskin_sim.verification.verdict import p_value
from eitskin_tools.bench.harness import Row, report, row_text, say
from eitskin_tools.bench.verify_conditions import SEED, Array, Condition, cloud_of, conditions, device_of, volts
from eitskin_tools.errors import UsageError
from eitskin_tools.evaluation.solvers import Request, bundle_for, named
from eitskin_tools.evaluation.verified.solver import MapVerdict, VerifiedNetwork

CALIBRATION = "calibration of p"
"""What ``--only`` calls the table of p."""

LEVELS: Final = (0.001, 0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9)
"""Stated."""

DRAWS: Final = 20
"""Draws of noise for each set of touches."""

Labels = Literal["units", "area"]

Judged = tuple[Score, Score, MapVerdict]
"""Scores of the network's map and of the verified one, and the verdict."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--deformations", type=int, default=6, metavar="N", help="of family A (default 6)")
    parser.add_argument("--each", type=int, default=4, metavar="N", help="touch sets at each of them (default 4)")
    parser.add_argument(
        "--only", action="append", metavar="ROW", help="only rows whose name contains this; may be repeated"
    )
    parser.add_argument(
        "--sets",
        type=int,
        default=50,
        metavar="N",
        help="touch sets for the check of p-values, 20 draws each (default 50; 0: none)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.deformations < 1 or arguments.each < 1 or arguments.sets < 0:
        raise UsageError("--deformations and --each must be at least 1, --sets at least 0")
    chosen = chosen_rows(arguments.only)
    rows: list[Row] = []
    for condition in conditions():
        if condition.name in chosen:
            start = time.process_time()
            rows.append(measured(condition, arguments.deformations, arguments.each))
            _say(row_text(rows[-1]), start)
    summary = {key: sum(row[key] for row in rows) for key in ("maps", "wrong", "wrong_unflagged")}
    return report(arguments, rows + _calibration(arguments), summary)


def chosen_rows(only: list[str] | None) -> set[str]:
    """Return the names of the rows that were asked for.

    Raises:
        UsageError: A text is in no name.
    """
    known = [*(one.name for one in conditions()), CALIBRATION]
    for text in only or ():
        if not any(text in name for name in known):
            raise UsageError(f"--only {text!r}: expected a part of one of: {', '.join(known)}")
    return {name for name in known if not only or any(text in name for text in only)}


def _calibration(arguments: argparse.Namespace) -> list[Row]:
    """Return the calibration of p; no rows unless it was asked for."""
    if CALIBRATION not in chosen_rows(arguments.only) or not arguments.sets:
        return []
    start = time.process_time()
    stated = matched(arguments.sets)
    _say(CALIBRATION, start)
    return stated


def _say(line: str, start_s: float) -> None:
    say("verify", f"{line} {time.process_time() - start_s:.0f} CPU-s")


def measured(condition: Condition, deformations: int, each: int) -> Row:
    """Return the figures of a condition, its p-values among them.

    Frames of one sheet come one after another: what the first of them show of its material serves the next.
    """
    phantoms = condition.phantoms(deformations, each)
    kind, labels = phantoms[0].scene.touch_kind, phantoms[0].truth
    network, filler = named(Request("vd2t"), labels, touches=kind).run, _filler(labels, kind)
    image: Array = np.zeros(PAPER.grid.shape)
    verified = VerifiedNetwork(
        Run(lambda case: image, "pre"), Noise(condition.noise), labels, kind, PAPER, at_rest=condition.at_rest
    )
    judged: list[Judged] = []
    for number in range(deformations):
        own = phantoms[number * each : (number + 1) * each]
        device = device_of(condition.mismatch, number)
        flat = volts(device.reference())
        untouched = np.full(len(flat), np.nan)
        if condition.at_rest:
            untouched = volts(device.scene(own[0].scene.untouched(), as_it_is=True))
        sheet = Sheet(cloud_of(device, own[0].scene.bend, number), untouched)
        rng = np.random.default_rng([SEED, number, 1 if labels == "units" else 2])
        for phantom in own:
            scene = device.scene(phantom.scene, as_it_is=labels == "units" or kind != "raise")
            gone = (int(rng.integers(N_ELECTRODES)),) if condition.missing else ()
            frames = np.tile(volts(scene), (condition.fused, 1))
            noisy = add_noise(frames, flat, condition.noise, 50.0, rng).mean(axis=0)
            filled = _filled(filler, noisy, flat, gone)
            case = Case(filled, flat, flat, sheet, labels, kind == "lower", condition.fused)
            image = network.solver(case)
            kept = np.where(rows_of(gone), 0.0, flat)
            checked = verified.solve(replace(case, voltages=noisy, reference=kept, flat_reference=kept))
            truth = truth_map(replace(phantom, scene=replace(phantom.scene, touches=scene.touches)))
            alone, found = (score(one, truth, labels=labels) for one in (image, checked))
            judged.append((alone, found, verified.checked[-1]))
    return {"what": condition.name, **_figures(judged, labels), **_counted(judged, labels)}


def _filler(labels: Labels, kind: TouchKind) -> RowImputation:
    arrays = bundle_for(Request("vd2t"), labels, kind).consistency_arrays()
    assert arrays is not None, "the shipped bundles fill in rows"
    return RowImputation(RowGaussian(np.asarray(arrays["mean"], float), np.asarray(arrays["covariance"], float)))


def _filled(filler: RowImputation, voltages_V: Array, flat_V: Array, gone: tuple[int, ...]) -> Array:
    """Return voltages with the rows of electrodes that are gone filled in, as the runtime does for its network."""
    if not gone:
        return voltages_V
    change = (voltages_V / flat_V - 1.0)[None]
    filler.fill(change, gone)
    return np.asarray(flat_V * (1.0 + change[0]))


def _counted(judged: list[Judged], labels: Labels) -> Row:
    """Return what is wrong and not flagged, what it took, and the p-values of what is right."""
    right = np.array([is_right(found, labels) for _, found, _ in judged])
    verdicts = [one for *_, one in judged]
    flagged = np.array([one.verdict.flagged for one in verdicts])
    cpu = np.array([one.cpu_ms for one in verdicts])
    setup = [one.setup_ms for one in verdicts if one.setup_ms]
    return {
        "wrong": int((~right).sum()),
        "wrong_unflagged": int((~right & ~flagged).sum()),
        "right_flagged": int((right & flagged).sum()),
        "chi_squared_median": float(np.median([one.verdict.chi_squared for one in verdicts])),
        "cpu_ms_median": float(np.median(cpu)),
        "cpu_ms_p95": float(np.percentile(cpu, 95)),
        "setup_ms_median": float(np.median(setup)) if setup else 0.0,
    }


def is_right(one: Score, labels: Labels) -> bool:
    """Return whether a map shows just the touched units, or as many touches as there are, each where it is."""
    if labels == "units":
        return one.exact == 1.0
    return one.touches == one.true_touches and one.localisation_mm <= MAX_MATCH_DISTANCE_MM


def _figures(judged: list[Judged], labels: Labels) -> Row:
    found: Row = {"maps": len(judged)}
    for name, own in (("network_", [one for one, _, _ in judged]), ("", [one for _, one, _ in judged])):
        right = float(np.mean([is_right(one, labels) for one in own]))
        if labels == "units":
            found[f"{name}exact"] = right
            continue
        distance = np.array([one.localisation_mm for one in own if one.localisation_mm < lost_mm(PAPER.grid)])
        found |= {
            f"{name}right": right,
            f"{name}cc": float(np.mean([one.cc for one in own])),
            f"{name}cc_worst": float(np.min([one.cc for one in own])),
            f"{name}localisation_median_mm": float(np.median(distance)) if len(distance) else None,
            f"{name}localisation_rms_mm": float(np.sqrt(np.mean(distance**2))) if len(distance) else None,
        }
    return found


def matched(sets: int) -> list[Row]:
    """Return a row for each noise and level: how often p was below it, over sets of 1 to 4 touches.

    Args:
        sets: How many, at one deformation of family A.
    """
    bend = trials.deformations_of(2, "A")[1]
    model = model_of_cloud(cloud_of(device_of(IDEAL, 1), bend, 1))
    flat = model.flat_V
    rows = []
    for law in NOISES:
        rng = np.random.default_rng(7)
        p: list[float] = []
        for _ in range(sets):
            touches = np.zeros((int(rng.integers(1, 5)), 8))
            touches[:, 0], touches[:, 3:5], touches[:, 6] = RECTANGLE, 10.0, 50.0
            touches[:, 1:3] = rng.uniform(10.0, np.array(model.skin.outline.size_mm) - 10.0, (len(touches), 2))
            change = model.solve(touches)[1]
            for _ in range(DRAWS):
                read = add_noise(flat * (1.0 + change), flat, law, 50.0, rng) / flat - 1.0
                white = Whitener(Noise(law).sd(read, flat), np.zeros((len(flat), 0)), 1.0 + read, None, 0.0)
                p.append(p_value(float(white.chi_squared(read - change)), len(flat)))
        rows += _below_levels(f"p, matched model, {law}", p)
    return rows


def _below_levels(what: str, p_values: list[float]) -> list[Row]:
    """Return a row for each level: how often p was below it, and the standard error of as many right answers."""
    p, count = np.array(p_values), len(p_values)
    return [
        {
            "what": what,
            "stated": level,
            "found": float(np.mean(p < level)),
            "error": sqrt(level * (1.0 - level) / count),
        }
        for level in LEVELS
    ]
