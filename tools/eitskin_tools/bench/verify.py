"""``eitskin bench verify``: how often the verifier of touches is right, and whether its p-values are calibrated.

Touches at deformations that no network has seen, on devices that differ from the nominal one, are solved on a mesh of
their own. The network answers, and the verifier starts from its map. A row counts the right answers, the wrong ones
that were not flagged, and the right ones that were. Rows appear on stderr as they are found; the calibration of p and
the JSON object come last. Times are CPU times of one core.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from math import sqrt
from typing import Any, Final

import numpy as np

from eitskin_proto.sensor.row_gaussian import RowGaussian, rows_of
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation import trials
from eitskin_sim.evaluation.device import Device
from eitskin_sim.evaluation.harness import Case, Run, Sheet
from eitskin_sim.evaluation.metrics import TOUCHED, Score, lost_mm, score
from eitskin_sim.evaluation.mismatch import IDEAL
from eitskin_sim.evaluation.near import NEAR_MM
from eitskin_sim.evaluation.truth import truth_map
from eitskin_sim.measurement.consistency import RowImputation
from eitskin_sim.measurement.noise import Kind, add_noise
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Bend, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_sim.scene.touch_table import RECTANGLE
from eitskin_sim.verification.residual import Noise, Whitener
from eitskin_sim.verification.shape_verifier import BUDGET_S
from eitskin_sim.verification.sheet_model import model_of_cloud
from eitskin_sim.verification.snapped_units import unit_shares
from eitskin_sim.verification.verdict import p_value
from eitskin_tools.bench.harness import Row, report, row_text, say
from eitskin_tools.bench.verify_conditions import (
    SEED,
    Anywhere,
    Array,
    Condition,
    anywhere_conditions,
    cloud_of,
    device_of,
    unit_conditions,
    volts,
)
from eitskin_tools.errors import UsageError
from eitskin_tools.evaluation.solvers import Request, bundle_for, named
from eitskin_tools.evaluation.verified.solver import VerifiedNetwork

CALIBRATION = "calibration of p"
"""What ``--only`` calls the table of p."""

LEVELS: Final = (0.001, 0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9)
"""Stated."""

DRAWS: Final = 20
"""Draws of noise for each set of touches."""


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
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    budget_ms = arguments.budget_ms or 0.0
    if arguments.deformations < 1 or arguments.each < 1 or arguments.sets < 0 or not budget_ms >= 0.0:
        raise UsageError("--deformations and --each must be at least 1, --sets and --budget-ms at least 0")
    units, anywhere = _rows(arguments, _chosen(arguments.only))
    every = [*units, *anywhere]
    summary = {key: sum(row[key] for row in every) for key in ("maps", "wrong", "wrong_unflagged")}
    return report(arguments, every + _calibration(arguments, units), summary)


def _chosen(only: list[str] | None) -> set[str]:
    """Return the names of the rows that were asked for.

    Raises:
        UsageError: There is none.
    """
    units, anywhere = unit_conditions(), anywhere_conditions()
    known = [*(one.name for one in units), *(one.name for one in anywhere), CALIBRATION]
    found = {name for name in known if not only or any(text in name for text in only)}
    if not found:
        texts = " ".join(repr(text) for text in only or ())
        raise UsageError(f"--only {texts}: expected a part of one of: {', '.join(known)}")
    return found


def _rows(arguments: argparse.Namespace, chosen: set[str]) -> tuple[list[Row], list[Row]]:
    """Return the rows of touched units and those of touches anywhere, each shown as it is found."""
    units: list[Row] = []
    anywhere: list[Row] = []
    measured: Units | None = None
    budget_s = None if arguments.budget_ms is None else 1e-3 * arguments.budget_ms
    for condition in unit_conditions():
        if condition.name in chosen:
            measured = measured or Units(arguments.deformations, arguments.each, budget_s)
            start = time.process_time()
            units.append(measured.row(condition))
            _say(row_text(units[-1]), start)
    for place in anywhere_conditions():
        if place.name in chosen:
            start = time.process_time()
            anywhere.append(anywhere_row(place, arguments.deformations, arguments.each))
            _say(row_text(anywhere[-1]), start)
    return units, anywhere


def _calibration(arguments: argparse.Namespace, units: list[Row]) -> list[Row]:
    """Return the calibration of p; no rows unless it was asked for."""
    if CALIBRATION not in _chosen(arguments.only) or not arguments.sets:
        return []
    start = time.process_time()
    stated = matched(arguments.sets) + of_rows(units)
    _say(CALIBRATION, start)
    return stated


def _say(line: str, start_s: float) -> None:
    say("verify", f"{line} {time.process_time() - start_s:.0f} CPU-s")


class Units:
    """Measures one row after another; what rows share is made once.

    Args:
        deformations: How many of family A.
        each: Touch sets at each of them.
        budget_s: The verifier's, for each frame; None is its own.
    """

    def __init__(self, deformations: int, each: int, budget_s: float | None) -> None:
        self._bends = trials.deformations_of(deformations, "A")
        self._each, self._budget_s = each, BUDGET_S if budget_s is None else budget_s
        self._network = named(Request("vd2t"), "units").run
        arrays = bundle_for(Request("vd2t"), "units").consistency_arrays()
        assert arrays is not None, "the shipped bundle of units fills in rows"
        self._filler = RowImputation(
            RowGaussian(np.asarray(arrays["mean"], float), np.asarray(arrays["covariance"], float))
        )
        self._image: Array = np.zeros(PAPER.grid.shape)

    def row(self, condition: Condition) -> Row:
        """Return the figures of a condition, its p-values among them.

        Frames of one sheet come one after another: what the first of them show of its material serves the next.
        """
        found, grid = [], PAPER.grid
        network = Run(lambda case: self._image, "pre")
        verified = VerifiedNetwork(
            network, Noise(condition.noise), "units", "raise", PAPER, self._budget_s, at_rest=condition.at_rest
        )
        for number, bend in enumerate(self._bends):
            device = device_of(condition.mismatch, number)
            flat = volts(device.reference())
            untouched = _volts(device, bend) if condition.at_rest else np.full(len(flat), np.nan)
            sheet = Sheet(cloud_of(device, bend, number), untouched)
            touches = np.random.default_rng([SEED, number, *condition.counts])
            rng = np.random.default_rng([SEED, number, 1])
            for _ in range(self._each):
                units, clean = _touched(condition, device, bend, touches)
                gone = (int(rng.integers(N_ELECTRODES)),) if condition.missing else ()
                noisy = add_noise(clean, flat, condition.noise, 50.0, rng)
                self._image = self._network.solver(Case(self._filled(noisy, flat, gone), flat, flat, sheet, "units"))
                kept = np.where(rows_of(gone), 0.0, flat)
                image = verified.solve(Case(noisy, kept, kept, sheet, "units"))
                alone, right = (
                    set(np.flatnonzero(unit_shares(one, grid) >= TOUCHED).tolist()) == set(units)
                    for one in (self._image, image)
                )
                found.append((alone, right, verified.checked[-1]))
        return {"what": condition.name, **figures(found), **counted(found)}

    def _filled(self, voltages_V: Array, flat_V: Array, gone: tuple[int, ...]) -> Array:
        """Return voltages with the rows of electrodes that are gone filled in, as the runtime does for its network."""
        change = (voltages_V / flat_V - 1.0)[None]
        if gone:
            self._filler.fill(change, gone)
        return np.asarray(flat_V * (1.0 + change[0]))


def _touched(condition: Condition, device: Device, bend: Bend, rng: np.random.Generator) -> tuple[list[int], Array]:
    """Return drawn units, the same whatever the device and the contrast, and the (104,) V of the sheet."""
    grid = PAPER.grid
    count = int(rng.integers(condition.counts[0], condition.counts[1] + 1))
    units = np.sort(rng.choice(grid.n_units, count, replace=False)).tolist()
    touches = []
    for unit in units:
        row, column = divmod(unit, grid.units[1])
        rect = Rect(*grid.unit_rect_mm(column, row))
        touches.append(Touch((rect,), contrast=condition.contrast, border_mm=condition.border_mm))
    return units, _volts(device, bend, tuple(touches))


def _volts(device: Device, bend: Bend, touches: tuple[Touch, ...] = ()) -> Array:
    return volts(device.scene(nominal_scene(PAPER, bend, touches), as_it_is=True))


def figures(maps: list[tuple[bool, bool, Any]]) -> Row:
    """Return shares of what is right: (network right, verifier right, verdict) of each map."""
    alone, right = (np.array([one[index] for one in maps]) for index in (0, 1))
    return {"maps": len(maps), "network_exact": float(alone.mean()), "exact": float(right.mean())}


def counted(maps: list[tuple[bool, bool, Any]]) -> Row:
    """Return what is wrong and not flagged, what it took, and the p-values of what is right."""
    right = np.array([one[1] for one in maps])
    flagged = np.array([one.verdict.flagged for _, _, one in maps])
    cpu = np.array([one.cpu_ms for _, _, one in maps])
    setup = [one.setup_ms for _, _, one in maps if one.setup_ms]
    return {
        "wrong": int((~right).sum()),
        "wrong_unflagged": int((~right & ~flagged).sum()),
        "right_flagged": int((right & flagged).sum()),
        "chi_squared_median": float(np.median([one.verdict.chi_squared for _, _, one in maps])),
        "cpu_ms_median": float(np.median(cpu)),
        "cpu_ms_p95": float(np.percentile(cpu, 95)),
        "setup_ms_median": float(np.median(setup)) if setup else 0.0,
        "p_values": [one.verdict.p_value for _, exact, one in maps if exact],
    }


def anywhere_row(condition: Anywhere, deformations: int, each: int) -> Row:
    """Return the figures of a condition, its p-values among them."""
    phantoms = condition.phantoms(deformations, each)
    kind = phantoms[0].scene.touch_kind
    network = named(Request("vd2t"), "area", touches=kind).run
    verified = VerifiedNetwork(network, Noise(condition.noise), "area", kind, PAPER, at_rest=condition.at_rest)
    found, scores = [], []
    for number in range(deformations):
        own = phantoms[number * each : (number + 1) * each]
        device = device_of(condition.mismatch, number)
        flat = volts(device.reference())
        untouched = (
            volts(device.scene(own[0].scene.untouched(), as_it_is=True))
            if condition.at_rest
            else np.full(len(flat), np.nan)
        )
        sheet = Sheet(cloud_of(device, own[0].scene.bend, number), untouched)
        rng = np.random.default_rng([SEED, number, 2])
        for phantom in own:
            scene = device.scene(phantom.scene, as_it_is=kind != "raise")
            noisy = add_noise(volts(scene), flat, condition.noise, 50.0, rng)
            case = Case(noisy, flat, flat, sheet, "area", kind == "lower")
            truth = truth_map(replace(phantom, scene=replace(phantom.scene, touches=scene.touches)))
            alone, checked = (score(solve(case), truth, labels="area") for solve in (network.solver, verified.solve))
            found.append((is_right(alone), is_right(checked), verified.checked[-1]))
            scores.append((alone, checked))
    return {"what": condition.name, **_figures(scores), **counted(found)}


def is_right(one: Score) -> bool:
    """Return whether a map has as many touches as there are, each where it is."""
    return one.touches == one.true_touches and one.localisation_mm <= NEAR_MM


def _figures(scores: Sequence[tuple[Score, Score]]) -> Row:
    found: Row = {"maps": len(scores)}
    for index, name in ((0, "network_"), (1, "")):
        own = [one[index] for one in scores]
        distance = np.array([one.localisation_mm for one in own if one.localisation_mm < lost_mm(PAPER.grid)])
        found |= {
            f"{name}right": float(np.mean([is_right(one) for one in own])),
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
    laws: tuple[Kind, ...] = ("N1", "N2", "N3")
    for law in laws:
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


def of_rows(units: list[Row]) -> list[Row]:
    """Return the same of the right answers of rows in which nothing but the scan's noise is off."""
    rows = []
    for row in units:
        if row["what"].startswith("1 to 6 units") and row["p_values"]:
            rows += _below_levels(f"p, {row['what']}, scanned", row["p_values"])
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
