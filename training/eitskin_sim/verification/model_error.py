"""How far a right model is off all the same, because the scan that it is made from is not exact.

Deformations are drawn, scanned with noise and fitted, and the voltages of the fitted surface are held against those of
the true one, in logarithms: 0.1 mm of noise is 0.8 % of V, three times the noise of 50 dB. Their covariance is kept as
its largest columns. It is that of the skin's deformations in general, not of the present one; draws have seeds of their
own. Material that lies elsewhere than the scan says is taken out as far as nuisances know it
(:mod:`eitskin_sim.verification.material`).
"""

from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import fit_cloud
from eitskin_sim.verification.material import moved, unseen_shifts
from eitskin_sim.verification.nuisance import factor_of

Array = npt.NDArray[np.float64]

SEED: Final = 44_021
"""Names the deformations and the scans."""

DRAWS: Final = 36
"""Scans whose errors are looked at: 4 s once a process, skin and noise."""

KEPT: Final = 24
"""Columns of the covariance that are kept."""


@lru_cache(maxsize=8)
def scan_columns(noise_mm: float = 0.1, skin: Skin = PAPER) -> Array:
    """Return (rows, m) log V for one standard deviation of every way in which a scan's noise changes the model.

    Args:
        noise_mm: Standard deviation of the scanner's noise.
        skin: Whose deformations.
    """
    sheet, found = nominal_sheet(skin), []
    for number, bend in enumerate(draw("A", DRAWS, SEED, skin)):
        even = replace(bend, nonuniformity=0.0)
        cloud = measured_cloud(even, np.random.default_rng([SEED, number]), noise_mm, skin=skin)
        true, shown = bend_metric(even, sheet), fit_cloud(cloud, skin.grid).metric
        known = moved(shown, (0.0, *unseen_shifts(true, shown, skin)), skin)
        found.append(np.log(factor_of(known, skin).voltages() / factor_of(true, skin).voltages()))
    left, size, _ = np.linalg.svd(np.array(found).T / np.sqrt(DRAWS), full_matrices=False)
    return np.asarray(left[:, :KEPT] * size[:KEPT])
