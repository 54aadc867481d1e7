"""The parameters of a touch that can be fitted, with their units.

Touches are rows of :mod:`eitskin_sim.scene.touch_table` with a border: kind, x, y, length, width, angle, contrast,
border. Derivatives are by ::

    x, y                     mm, of the centre
    half length, half width  mm; of a disc the radius, which is its half length
    angle                    rad, of rectangles and ellipses
    log contrast             of either sign: below 0 where a press lowers conductance
    border                   mm, of graded borders alone: a sharp one has no derivative

"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.arrays import Array
from eitskin_sim.scene.touch_table import DISC, RECTANGLE

X, Y, HALF_LENGTH, HALF_WIDTH, ANGLE, LOG_CONTRAST, BORDER = range(7)
"""Places of the parameters of one touch."""

N_PARAMETERS: Final = 7
"""Parameters of one touch."""

NAMES: Final = ("x_mm", "y_mm", "half_length_mm", "half_width_mm", "angle_rad", "log_contrast", "border_mm")


def parameters_of(pieces: Array) -> Array:
    """Return (n, 7) parameters of (n, 8) touches."""
    found = pieces[:, 1:8].copy()
    found[:, HALF_LENGTH : HALF_WIDTH + 1] /= 2.0
    found[:, ANGLE] = np.deg2rad(found[:, ANGLE])
    found[:, LOG_CONTRAST] = np.log(found[:, LOG_CONTRAST])
    return np.asarray(found)


def pieces_of(kinds: Array, parameters: Array) -> Array:
    """Return (n, 8) touches of some kinds (n,) with parameters (n, 7)."""
    found = np.column_stack([kinds, parameters])
    found[:, 3:5] *= 2.0
    found[:, 5] = np.rad2deg(found[:, 5])
    found[:, 6] = np.exp(found[:, 6])
    return np.asarray(found)


def free(pieces: Array) -> npt.NDArray[np.bool_]:
    """Return (n, 7) which parameters of touches change anything: discs have one size and no angle."""
    found = np.ones((len(pieces), N_PARAMETERS), dtype=np.bool_)
    found[pieces[:, 0] == DISC, HALF_WIDTH] = False
    found[pieces[:, 0] == DISC, ANGLE] = False
    found[pieces[:, 7] == 0.0, BORDER] = False
    return found


def areas_mm2(pieces: Array) -> Array:
    """Return (n,) areas within the outlines, on the flat sheet."""
    full = np.where(pieces[:, 0] == RECTANGLE, 1.0, np.pi / 4)
    return np.asarray(full * pieces[:, 3] * np.where(pieces[:, 0] == DISC, pieces[:, 3], pieces[:, 4]))


def strengths_mm2(pieces: Array) -> Array:
    """Return (n,) log contrast times area: what a touch does to the log of the sheet's conductance, added up.

    A graded border has its outline at half height, so that it adds outside what it takes inside, but for its curvature.
    """
    return np.asarray(np.log(pieces[:, 6]) * areas_mm2(pieces))
