"""Whether p keeps its word where the model is right: the same sheet, exactly condensed, with nothing but noise."""

import time
from typing import Any, Final

import numpy as np

from eitskin_proto.sensor.normalise import relative_change
from eitskin_sim.evaluation import trials
from eitskin_sim.measurement.noise import Kind, add_noise
from eitskin_sim.reduced.exact import exact_sheet
from eitskin_sim.reduced.making import reduced
from eitskin_sim.reduced.model import rows_of
from eitskin_sim.reduced.state import state_of
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Sheet
from eitskin_sim.verification.chi_squared import calibration
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.unit_sheet import flat_of
from eitskin_sim.verification.units import CONTRAST, UnitVerifier

LEVELS: Final = (0.001, 0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9)
"""Stated."""

DRAWS: Final = 20
"""Draws of noise for each set of touches."""


def matched(sets: int) -> list[dict[str, Any]]:
    """Return a row for each noise and level: how often p was below it, over sets of 1 to 12 units.

    Args:
        sets: How many, at one deformation of family A.
    """
    sheet = exact_sheet(bend_metric(trials.deformations_of(2, "A")[1], Sheet()))
    model, flat = reduced(sheet), flat_of()
    verifier = UnitVerifier(model, flat)
    rows = []
    laws: tuple[Kind, ...] = ("N1", "N2", "N3")
    for law in laws:
        rng = np.random.default_rng(7)
        p = []
        for _ in range(sets):
            units = rng.choice(model.n_units, int(rng.integers(1, 13)), replace=False)
            touched = np.zeros(model.n_units, dtype=np.bool_)
            touched[units] = True
            volts = rows_of(sheet.currents(units, np.full(len(units), CONTRAST))[1])
            for _ in range(DRAWS):
                change = relative_change(add_noise(volts, flat, law, 50.0, rng), flat)
                noise = Noise(law)
                p.append(verifier.verify(change, flat, [touched], noise, budget_s=0.0).p_value)
        rows += [
            {"what": f"p, matched model, {law}", "stated": one.stated, "found": one.found, "error": one.error}
            for one in calibration(p, LEVELS)
        ]
    return rows


def of_rows(units: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the same of the right answers of rows in which nothing but the scan's noise is off."""
    rows = []
    for row in units:
        if row["what"].startswith("1 to 6 units") and row["p_values"]:
            rows += [
                {"what": f"p, {row['what']}, scanned", "stated": one.stated, "found": one.found, "error": one.error}
                for one in calibration(row["p_values"], LEVELS)
            ]
    return rows


def candidates() -> list[dict[str, Any]]:
    """Return what a step costs: microseconds of the processor for one candidate beside sets of 1 to 12 units."""
    model = reduced(exact_sheet(bend_metric(trials.deformations_of(2, "A")[1], Sheet())))
    rng, rows = np.random.default_rng(8), []
    for count in (1, 3, 6, 12):
        spans, alone = [], []
        for _ in range(30):
            units = rng.choice(model.n_units, count, replace=False)
            free = np.setdiff1d(np.arange(model.n_units), units)
            start = time.process_time_ns()
            state = state_of(model, units, np.full(count, CONTRAST))
            middle = time.process_time_ns()
            state.with_each(free, CONTRAST)
            spans.append((time.process_time_ns() - middle) / 1e3 / len(free))
            alone.append((middle - start) / 1e3)
        rows.append({"what": f"a candidate beside {count} units", "cpu_us": float(np.median(spans)),
                     "set_cpu_us": float(np.median(alone)), "model_MB": model.nbytes / 1e6})  # fmt: skip
    return rows
