"""How one fit becomes a better one: usual contrasts, one body where the network shows one, and what it confirms.

Each returns what it was given where nothing pays or time is over.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from eitskin_sim.scene.touch_table import Array
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.fit import Fit, Frame, refine
from eitskin_sim.verification.free.seen import BESIDE, DECISIVE, joints_of, together, unseen

STEPS: Final = 10
"""Derivatives taken of a fit at most."""

SURER: Final = 20.0
"""What costs so much less is beyond doubt."""

AGAINST_JOINT: Final = 10.0
"""Chi-squared that each joint may leave more: beyond it is one of a hundred bodies, as two degrees of freedom have."""

IMPOSSIBLE: Final = (ValueError, np.linalg.LinAlgError)
"""What touches raise that cannot be."""


def fitted(
    frame: Frame,
    pieces: Array,
    turning: bool,
    effort: Effort,
    over: Callable[[], bool],
) -> Fit:
    """Return touches fitted to a frame.

    Raises:
        ValueError: They cannot be.
    """
    effort.fits += 2
    return refine(frame, frame.at(pieces, turning), STEPS, over)


def confirmed(frame: Frame, fit: Fit, shares: Array, effort: Effort) -> tuple[Fit, bool]:
    """Return the fit without touches that physics alone sees and that explain little; and whether time sufficed."""
    least = BESIDE if len(shares) else DECISIVE
    for number in reversed(unseen(fit.pieces, shares, frame.model.skin.grid)):
        if effort.over():
            return fit, False
        other = without(frame, fit, number, effort)
        if other.chi_squared - fit.chi_squared < least:
            fit = other
        elif effort.over():
            return fit, False  # more time for what is left might have explained the frame as well
    return fit, True


def joined(frame: Frame, fit: Fit, shares: Array, effort: Effort) -> Fit:
    """Return the fit with what the network shows as one touch made one body, unless a frame speaks against it.

    Its frame has the joints then: errors and other contrasts are those of the body.

    Args:
        frame: The frame.
        fit: Of it.
        shares: (n, rows, columns) of the network's map.
        effort: Time.
    """
    grid = frame.model.skin.grid
    joints = joints_of(fit.pieces, shares, grid)
    if not joints or effort.searched():
        return fit
    try:
        bound = replace(frame, joints=joints)
        found = fitted(bound, together(fit.pieces, joints, shares, grid), fit.turning, effort, effort.searched)
    except IMPOSSIBLE:
        return fit
    return found if found.chi_squared - fit.chi_squared < AGAINST_JOINT * len(joints) else fit


def without(frame: Frame, fit: Fit, number: int, effort: Effort) -> Fit:
    """Return the fit without one of its touches, the others fitted anew."""
    return fitted(frame, np.delete(fit.pieces, number, axis=0), fit.turning, effort, effort.over)


def usually(frame: Frame, fit: Fit, effort: Effort) -> Fit:
    """Return the fit, or one from touches of usual contrast that are as strong, if that is likelier.

    Size and contrast lie in a long valley, in which steps are short.
    """
    usual = frame.usual.log_contrast
    log = np.log(fit.pieces[:, 6])
    if effort.searched() or not len(log) or usual * log.mean() <= 0.0 or abs(usual - log.mean()) < 0.5:
        return fit
    pieces = fit.pieces.copy()
    pieces[:, 3:5] *= np.sqrt(np.clip(np.tanh(log / 2.0) / np.tanh(usual / 2.0), 0.3, 3.0))[:, None]
    pieces[:, 6] = np.exp(usual)
    pieces[:, 7] = np.minimum(pieces[:, 7], pieces[:, 3:5].min(axis=1) - 0.01)
    try:
        other = fitted(frame, pieces, fit.turning, effort, effort.searched)
    except IMPOSSIBLE:
        return fit
    return other if other.cost < fit.cost else fit
