"""How a skin's deformations usually lay the material under the points of a scan: which waves come together.

Deformations of the skin's family are drawn and scanned without noise, and the waves are found that turn the metric of
each cloud into the sheet's own. Few directions carry nearly all: uneven stretch along the sheet, and what twist does.
What other deformations do, bumps among them, is left to each wave alone, by a share of its own spread.
"""

from functools import lru_cache
from typing import Final

import numpy as np

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.scene.bend import metric
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.touch_table import Array
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import fit_cloud
from eitskin_sim.verification.free.sheet.waves import waves_of

SEED: Final = 44_217
"""Names the deformations."""

DRAWS: Final = 32
"""Deformations that are looked at: 3 s once a process and skin."""

DIRECTIONS: Final = 8
"""Of them that are kept."""

ALONE: Final = 0.35
"""Share of its spread that every wave has for itself."""

ROUNDS: Final = 3
"""Derivatives taken until a metric is met."""


@lru_cache(maxsize=4)
def usual_waves(skin: Skin = PAPER) -> Array:
    """Return (w, m) amplitudes of the waves for one standard deviation of every way in which they come."""
    sheet, waves = nominal_sheet(skin), waves_of(skin)
    x, y = ((np.arange(n) + 0.5) * extent / n for n, extent in zip((24, 16), skin.outline.size_mm, strict=True))
    at = np.stack([one.ravel() for one in np.meshgrid(x, y)], axis=-1)
    found = []
    for bend in draw("A", DRAWS, SEED, skin):
        scanned, true = fit_cloud(measured_cloud(bend, None, skin=skin), skin.grid).metric, metric(bend, sheet, at)
        total = np.zeros(len(waves.sd))
        for _ in range(ROUNDS):
            moved = waves.moved(scanned, total)
            rates = np.concatenate(waves.rates(moved, at)) * waves.sd
            left = (true - moved(at)).T.ravel()
            held = rates.T @ rates + 1e-3 * np.eye(rates.shape[1])
            total = total + waves.sd * np.linalg.solve(held, rates.T @ left)
        found.append(total)
    left_, size, _ = np.linalg.svd(np.array(found).T / np.sqrt(DRAWS), full_matrices=False)
    return np.concatenate([left_[:, :DIRECTIONS] * size[:DIRECTIONS], np.diag(ALONE * waves.sd)], axis=1)
