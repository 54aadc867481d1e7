"""How noisy a scan is, by the scan itself: how far its points lie from the smooth surface through them.

A scanner may be worse than the skin says, and a surface rougher than the spline can follow. Both misplace the model,
and both show here. A spline of n coefficients takes its part of the noise with it, which is put back ::

    noise^2 = sum of squared distances / (3 (points - n))
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.surface.predict import FittedSurface

MOST_MM: Final = 2.0
"""More is not believed: a cloud that is so far off is of another surface."""


def scan_noise_mm(cloud_mm: npt.ArrayLike, surface: FittedSurface, grid: Grid = PAPER.grid) -> float:
    """Return the standard deviation of a scan's points along each direction of space, at most ``MOST_MM``.

    Args:
        cloud_mm: (3, rows, columns) mm.
        surface: Fitted to it.
        grid: Of the cloud.
    """
    points = surface.points(grid.pixel_centres_mm().reshape(-1, 2))
    off = np.asarray(cloud_mm, dtype=np.float64).reshape(3, -1).T - points
    free = max(len(points) - surface.coefficients[..., 0].size, 1)
    return float(min(np.sqrt(np.sum(off**2) / (3 * free)), MOST_MM))
