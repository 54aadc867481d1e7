"""Whether p keeps its word where the model is right: the sheet is the model's own, with nothing but noise."""

from typing import Any, Final

import numpy as np

from eitskin_sim.evaluation import trials
from eitskin_sim.evaluation.mismatch import IDEAL
from eitskin_sim.measurement.noise import Kind, add_noise
from eitskin_sim.scene.touch_table import RECTANGLE
from eitskin_sim.verification.chi_squared import calibration, p_value
from eitskin_sim.verification.residual import Noise, Whitener
from eitskin_sim.verification.sheet_model import model_of_cloud
from eitskin_tools.bench.verify.truth import cloud_of, device_of

LEVELS: Final = (0.001, 0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9)
"""Stated."""

DRAWS: Final = 20
"""Draws of noise for each set of touches."""


def matched(sets: int) -> list[dict[str, Any]]:
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
