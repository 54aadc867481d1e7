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
from eitskin_sim.verification.free.found import explained
from eitskin_sim.verification.free.moves import Move, moves
from eitskin_sim.verification.free.seen import BESIDE, DECISIVE, joints_of, shown_as, together, unseen

ALMOST: Final = 3
"""Derivatives taken of a move before it is judged."""

STEPS: Final = 10
"""Derivatives taken of a fit at most."""

WEAK: Final = 1.0
"""A touch whose contrast's logarithm is nearer to 0 than usual by more may be two,"""

LONG_MM: Final = 20.0
"""if it is as long,"""

LONG: Final = 1.6
"""and so many times as long as wide."""

APART: Final = 0.28
"""The two lie by so much of its length to either side of its centre."""

NARROW: Final = 1.2
"""A touch that is so many times as long as wide may be two,"""

GAP_MM: Final = 10.0
"""so far apart at first,"""

SURER: Final = 20.0
"""if they cost so much less."""

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


def fewer(frame: Frame, fit: Fit, effort: Effort) -> Fit:
    """Return the fit, or one without the smallest of the touches, if that is likelier."""
    for number in np.argsort(areas_mm2(fit.pieces))[:2].tolist() if len(fit.pieces) > 1 else ():
        if effort.searched():
            break
        other = without(frame, fit, number, effort)
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


def parted(frame: Frame, fit: Fit, effort: Effort) -> Fit:
    """Return the fit, or one with two touches of usual contrast in place of a long weak one, if that is likelier.

    Two touches near each other read nearly as one over both and what lies between, at a tenth of their contrast.
    """
    if not len(fit.pieces) or effort.searched():
        return fit
    largest = int(np.argmax(areas_mm2(fit.pieces)))
    piece, usual = fit.pieces[largest], frame.usual.log_contrast
    log, length, width = float(np.log(piece[6])), float(piece[3:5].max()), float(piece[3:5].min())
    if usual * log <= 0.0 or abs(usual) - abs(log) <= WEAK or length < max(LONG_MM, LONG * width):
        return fit
    side = _side_of_two_mm(piece, usual)
    turn = np.deg2rad(piece[5]) + int(np.argmax(piece[3:5])) * np.pi / 2
    two = np.vstack([piece, piece])
    two[:, 1:3] += np.outer([-APART, APART], [np.cos(turn), np.sin(turn)]) * length
    two[:, 3:5], two[:, 6] = side, np.exp(usual)
    two[:, 7] = np.minimum(two[:, 7], side - 0.01)
    pieces = np.vstack([np.delete(fit.pieces, largest, axis=0), two])
    try:
        other = fitted(frame, pieces, fit.turning, effort, effort.searched)
    except IMPOSSIBLE:
        return fit
    return other if other.cost < fit.cost else fit


def apart(frame: Frame, fit: Fit, shares: Array, effort: Effort) -> Fit:
    """Return the fit, or one with two touches that lie apart in place of a large one, if they explain more.

    On a sheet that is known badly one between the two explains a frame, too. It is one where the network shows it as
    large besides.

    Args:
        frame: The frame.
        fit: Of it.
        shares: (n, rows, columns) of the network's map.
        effort: Time.
    """
    if not len(fit.pieces) or effort.searched():
        return fit
    largest = int(np.argmax(areas_mm2(fit.pieces)))
    piece = fit.pieces[largest]
    along = int(np.argmax(piece[3:5]))
    if piece[3 + along] < NARROW * piece[4 - along]:
        return fit
    if explained(fit) and shown_as(piece, shares, frame.model.skin.grid):
        return fit
    log, usual, two = float(np.log(piece[6])), frame.usual.log_contrast, np.vstack([piece, piece])
    if usual * log > 0.0 and abs(usual) - abs(log) > WEAK:
        log, two[:, 6] = usual, np.exp(usual)
    side = _side_of_two_mm(piece, log)
    turn = np.deg2rad(piece[5]) + along * np.pi / 2
    two[:, 1:3] += np.outer([-0.5, 0.5], [np.cos(turn), np.sin(turn)]) * (side + GAP_MM)
    two[:, 3:5], two[:, 7] = side, np.minimum(two[:, 7], side - 0.01)
    pieces = np.vstack([np.delete(fit.pieces, largest, axis=0), two])
    try:
        other = fitted(frame, pieces, fit.turning, effort, effort.searched)
    except IMPOSSIBLE:
        return fit
    return other if other.cost < fit.cost - SURER else fit


def _side_of_two_mm(piece: Array, log: float) -> float:
    """Return the side of two squares of a log contrast that are together as strong as a touch."""
    strength = np.tanh(np.log(piece[6]) / 2.0) / np.tanh(log / 2.0)
    return float(np.sqrt(piece[3] * piece[4] / 2.0 * strength))


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
