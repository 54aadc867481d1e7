"""The prior's cost of touches: residuals whose squares are minimised with a frame's, and their derivatives.

::

    size        log sqrt(area) about that of touches; log(length / width) about 0, with heavy tails
    contrast    its logarithm: the mean of all touches about what this skin's are, each about that mean
    border      of those that have a graded one
    joints      shapes that are one touch have no crack between them, and one contrast
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.scene.touch_table import Array
from eitskin_sim.shapes.parameters import ANGLE, BORDER, HALF_LENGTH, HALF_WIDTH, LOG_CONTRAST, free, parameters_of
from eitskin_sim.verification.free.prior.joints import Joints, joint_costs, joint_rates
from eitskin_sim.verification.free.usual import Usual

TAIL: Final = 2.0
"""Of the law of aspects: the smaller, the heavier."""

SMALL: Final = 1e-6
"""Residual below which a heavy tail is a square."""


def own_parameters(pieces: Array, turning: bool) -> npt.NDArray[np.bool_]:
    """Return (n, 7) which parameters of touches are fitted: angles only if they are to turn."""
    found = free(pieces)
    found[:, ANGLE] &= turning
    return found


def costs(pieces: Array, own: npt.NDArray[np.bool_], usual: Usual, joints: Joints = ()) -> Array:
    """Return the (p,) residuals of the prior; the last is that of the mean contrast.

    Args:
        pieces: (n, 8) touches.
        own: (n, 7) which parameters are free.
        usual: What touches are like.
        joints: Which of them hang together.
    """
    if not len(pieces):
        return np.zeros(0)
    values = parameters_of(pieces)
    length, width, log = values[:, HALF_LENGTH], values[:, HALF_WIDTH], values[:, LOG_CONTRAST]
    graded = own[:, BORDER]
    return np.concatenate(
        [
            0.5 * np.log(4.0 * length * width / usual.touches.size_mm**2) / usual.touches.size_log_sd,
            heavy(np.log(length / width), usual.aspect_sd)[0],
            (log - log.mean()) / usual.own_sd,
            (values[graded, BORDER] - usual.border_mm) / usual.border_sd,
            joint_costs(values, joints),
            [(log.mean() - usual.log_contrast) / usual.common_sd],
        ]
    )


def cost_rates(pieces: Array, own: npt.NDArray[np.bool_], usual: Usual, joints: Joints = ()) -> Array:
    """Return the (p, r) derivatives of :func:`costs` by the free parameters."""
    n = len(pieces)
    if not n:
        return np.zeros((0, 0))
    values, each, graded = parameters_of(pieces), np.arange(n), np.flatnonzero(own[:, BORDER])
    length, width = values[:, HALF_LENGTH], values[:, HALF_WIDTH]
    slope = heavy(np.log(length / width), usual.aspect_sd)[1]
    rates = joint_rates(values, joints)
    by = np.zeros((3 * n + len(graded) + len(rates) + 1, *own.shape))
    by[each, each, HALF_LENGTH] = 0.5 / length / usual.touches.size_log_sd
    by[each, each, HALF_WIDTH] = 0.5 / width / usual.touches.size_log_sd
    by[n + each, each, HALF_LENGTH], by[n + each, each, HALF_WIDTH] = slope / length, -slope / width
    by[2 * n : 3 * n, :, LOG_CONTRAST] = (np.eye(n) - 1.0 / n) / usual.own_sd
    by[3 * n + np.arange(len(graded)), graded, BORDER] = 1.0 / usual.border_sd
    by[3 * n + len(graded) : -1] = rates
    by[-1, :, LOG_CONTRAST] = 1.0 / n / usual.common_sd
    return np.asarray(by[:, own])


def heavy(value: Array, sd: float) -> tuple[Array, Array]:
    """Return residuals whose squares are the cost of Student's law with ``TAIL`` degrees of freedom, and slopes."""
    square = value * value / (TAIL * sd * sd)
    residual = np.copysign(np.sqrt(TAIL * np.log1p(square)), value)
    small = np.abs(residual) < SMALL
    slope = value / (sd * sd * (1.0 + square) * np.where(small, 1.0, residual))
    return np.where(small, value / sd, residual), np.where(small, 1.0 / sd, slope)
