"""Chooses the drives that an idle device scans: the four with the most information about a small touch.

With the bends as a nuisance, log(V / V0) of untouched frames has a covariance C (bends and noise together), and a touch
that adds s with an unknown strength of unit variance has with it the mutual information

    I(rows) = 1/2 log(1 + s' C^-1 s)        s and C cut to the rows of the drives that are scanned

averaged over small touches. All subsets are searched. The best one drive keeps 0.4 of the information of all 104 rows,
the best two 0.7, three 0.8, four 0.85, and each further one a few hundredths; four of fourteen drives that have rows
take two sevenths of the time. A frame of drive k holds the rows with drive < measure, so low drives bring more.
"""

from itertools import combinations
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS
from eitskin_proto.wire.scan_rows import drives_from_list, table_rows
from eitskin_sim.arrays import Array
from eitskin_training.gate.material import Material

DRIVES: Final = 4
"""How many drives an idle device scans."""

FRAMES: Final = 8192
TOUCHES: Final = 100
"""Untouched frames for the covariance, and touches for the mean."""

MIN_RATIO: Final = 0.05
"""V / V0 is not taken for less, as in the gate."""


def information(covariance: Array, touches: Array, rows: npt.NDArray[np.intp]) -> float:
    """Return the mean information in nats that some rows hold about a touch.

    Args:
        covariance: (104, 104) of log(V / V0) of untouched frames.
        touches: (t, 104) log(V touched / V untouched).
        rows: Which rows are measured.
    """
    root = np.linalg.cholesky(covariance[np.ix_(rows, rows)])
    whitened = np.linalg.solve(root, touches[:, rows].T)
    return float(0.5 * np.log1p(np.square(whitened).sum(axis=0)).mean())


def covariance_of(dv: Array) -> Array:
    """Return the (104, 104) covariance of log(V / V0) of noisy untouched frames (n, 104)."""
    return np.asarray(np.cov(np.log(np.maximum(1.0 + dv, MIN_RATIO)).T) + 1e-8 * np.eye(N_ROWS))


def idle_choice(material: Material, rng: np.random.Generator) -> int:
    """Return the drives that an idle device scans, 16 bits."""
    covariance = covariance_of(material.noisy_untouched(FRAMES, rng))
    weakest = np.argsort(np.abs(material.touches).mean(axis=1))[: max(len(material.touches) // 2, 1)]
    touches = material.touches[rng.choice(weakest, size=min(TOUCHES, len(weakest)), replace=False)]
    masks = [drives_from_list(list(drives)) for drives in combinations(range(N_ELECTRODES), DRIVES)]
    return max(masks, key=lambda mask: information(covariance, touches, table_rows(False, mask)))
