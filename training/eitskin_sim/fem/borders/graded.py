"""The graded border of a touch: how log conductivity runs across it, and the kink that the potential has there.

With d the distance from the outline (negative inside), b the border's width and c the contrast,

    log sigma = p(d) log c,    p = 1 for d < -b/2,    1/2 - d/b between,    0 for d > b/2

Across a border the current density is even, so the potential's slope goes as 1 / sigma. A slope that is 0 inside, 1
outside and a linear function of 1 / sigma between is w; its integral psi takes the place of the sharp kink max(d, 0):

    w = (c^u - 1) / (c - 1),    psi = b ((c^u - 1) / log c - u) / (c - 1),    u = d/b + 1/2 from 0 to 1

and w, psi become the sharp kink's as b goes to 0, from contrasts above 1 and below.
"""

import numpy as np

from eitskin_sim.arrays import Array


def plateau(distance: Array, border_mm: Array | float) -> Array:
    """Return p: the share of the log contrast that a touch has at a distance, mm."""
    return np.asarray(np.clip(0.5 - distance / border_mm, 0.0, 1.0))


def kink(distance: Array, log_contrast: Array, border_mm: Array) -> tuple[Array, Array]:
    """Return psi, mm, and its slope w along the normal; all arguments broadcast, no log contrast is 0."""
    u = np.clip(distance / border_mm + 0.5, 0.0, 1.0)
    rise, whole = np.expm1(log_contrast * u), np.expm1(log_contrast)
    beyond = np.maximum(distance - border_mm / 2, 0.0)
    return np.asarray(border_mm * (rise / log_contrast - u) / whole + beyond), np.asarray(rise / whole)
