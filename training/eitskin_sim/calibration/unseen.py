"""A reference of a bent or stretched sheet with its scan, and the scan's unseen error.

The model of such a reference is the scanned sheet. Its error (:mod:`eitskin_sim.calibration.bends`) is drawn for scans
like this one. Everything relative to the reference has the same error, so it is not noise but parameters ::

    log V0 = log V_model(scan) + mean + gauge steeper + root u        u (104,), each of prior standard deviation 1

A row and its reciprocal have the same error, so with 208 rows the front end is found as for a flat sheet.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.calibration.bends import bend_error, scan_error
from eitskin_sim.calibration.parameters import ParameterGroup
from eitskin_sim.calibration.solved import Metric
from eitskin_sim.surface.predict import fit_cloud

UNSEEN: Final = "reference_unseen"
"""Group of the parameters u, which are no numbers of the skin's file."""


@dataclass(frozen=True, slots=True, eq=False)
class Unseen:
    """A scanned reference's surface, and what its model is off by."""

    metric: Metric
    """Of the surface through the scan."""
    mean: Array
    """(104,) of the logarithm."""
    root: Array
    """(104, 104) its covariance is root root^T."""
    steeper: float
    """By which share voltages follow a gauge factor more than the scan's model says."""
    largest: float
    """Largest squared distance a row, relative to the covariance's, of an honest device."""

    @property
    def group(self) -> ParameterGroup:
        """The parameters."""
        return ParameterGroup(UNSEEN, "", np.zeros(N_ROWS), 1.0)

    @property
    def expected_rms(self) -> float:
        """The expected errors of the logarithms of voltages."""
        return float(np.sqrt(np.mean(np.sum(self.root**2, axis=1))))


def unseen_of(skin: Skin, cloud_mm: Array) -> Unseen:
    """Return the unseen error of a reference; takes half a minute for each new scan.

    Args:
        skin: Its deformations, and how it is scanned.
        cloud_mm: (3, rows, columns) the scan.
    """
    surface = fit_cloud(cloud_mm, skin.grid)
    error = bend_error(skin, scan_error(cloud_mm, surface, skin.grid))
    root = np.asarray(np.linalg.cholesky(error.covariance), dtype=np.float64)
    return Unseen(surface.metric, error.mean, root, error.steeper, error.largest)
