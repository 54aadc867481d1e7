"""How one fit becomes a better one: moves, fewer touches, usual contrasts, and what the network does not confirm.

Each returns what it was given where nothing pays or time is over.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from eitskin_sim.scene.touch_table import Array
from eitskin_sim.shapes.parameters import areas_mm2
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.fit import ENOUGH, Fit, Frame, refine
from eitskin_sim.verification.free.moves import Move, moves
from eitskin_sim.verification.free.seen import BESIDE, DECISIVE, joints_of, together, unseen

ALMOST: Final = 3
"""Derivatives taken of a move before it is judged."""

STEPS: Final = 10
"""Derivatives taken of a fit at most."""

HOPELESS: Final = 1000.0
"""Cost that fewer touches may have more, before the others are fitted anew, where nothing speaks for fewer."""

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
    steps: int = STEPS,
    enough: float = ENOUGH,
) -> Fit:
    """Return touches fitted to a frame.

    Raises:
        ValueError: They cannot be.
    """
    effort.fits += 2
    return refine(frame, frame.at(pieces, turning), steps, over, enough)


def moved(frame: Frame, fit: Fit, effort: Effort) -> tuple[str, Fit | None]:
    """Return the move that pays, or none."""
    tried: list[tuple[Fit, Move]] = []
    for move in moves(frame, fit):
        if effort.searched():
            break
        try:
            found = fitted(frame, move[1], move[2], effort, effort.searched, ALMOST)
        except IMPOSSIBLE:
            continue
        tried.append((found, move))
        if found.cost < fit.cost - 0.3 * (fit.chi_squared - len(fit.residual)) - 10.0:
            break  # a good part of what is unexplained: no need to look at the others
    tried.sort(key=lambda one: one[0].cost)
    for found, move in tried[:2]:
        effort.fits += 1
        whole = refine(frame, found, STEPS, effort.searched)
        if whole.cost < fit.cost - 1.0:
            return move[0], whole
    return "", None


def fewer(frame: Frame, fit: Fit, effort: Effort, anyhow: bool = True) -> Fit:
    """Return the fit, or one without the smallest of the touches, if that is likelier.

    Args:
        frame: The frame.
        fit: Of it.
        effort: Time.
        anyhow: Whether fewer may be right however much they leave before they are fitted.
    """
    for number in np.argsort(areas_mm2(fit.pieces))[: 2 if anyhow else 1].tolist() if len(fit.pieces) > 1 else ():
        if effort.searched():
            break
        left = frame.at(np.delete(fit.pieces, number, axis=0), fit.turning)
        if not anyhow and left.cost > fit.cost + HOPELESS:
            continue
        effort.fits += 1
        other = refine(frame, left, STEPS, effort.over)
        if other.cost < fit.cost:
            return other
    return fit


def straightened(frame: Frame, fit: Fit, effort: Effort) -> Fit:
    """Return the fit, or one with all touches upright where they are turned, if that is likelier."""
    if not fit.turning or effort.searched():
        return fit
    pieces = fit.pieces.copy()
    across = np.abs(np.mod(pieces[:, 5], 180.0) - 90.0) < 45.0
    pieces[across, 3:5] = pieces[across, 4:2:-1]
    pieces[:, 5] = 0.0
    try:
        other = fitted(frame, pieces, False, effort, effort.searched)
    except IMPOSSIBLE:
        return fit
    return other if other.cost < fit.cost else fit


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
