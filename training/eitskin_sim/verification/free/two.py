"""One touch that may be two, long and weak ones and those that lie between the two; and two that may be one.

Each returns what it was given where nothing else is likelier or time is over.
"""

from typing import Final

import numpy as np

from eitskin_sim.scene.gap import gap_mm
from eitskin_sim.scene.touch_table import Array
from eitskin_sim.shapes.parameters import areas_mm2
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.fit import Fit, Frame
from eitskin_sim.verification.free.found import explained
from eitskin_sim.verification.free.improve import IMPOSSIBLE, SURER, fitted
from eitskin_sim.verification.free.seen import shown_as

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
"""so far apart at first, if they cost beyond doubt less."""

OVER_MM: Final = -3.0
"""A gap from which another touch lies over it, and is a part of the two as well."""


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
    over = gap_mm(np.tile(piece, (len(fit.pieces), 1)), fit.pieces) < OVER_MM
    over[largest] = True  # a thin one lies over itself by less
    try:
        other = fitted(frame, np.vstack([fit.pieces[~over], two]), fit.turning, effort, effort.searched)
    except IMPOSSIBLE:
        return fit
    return other if other.cost < fit.cost - SURER else fit


def _side_of_two_mm(piece: Array, log: float) -> float:
    """Return the side of two squares of a log contrast that are together as strong as a touch."""
    strength = np.tanh(np.log(piece[6]) / 2.0) / np.tanh(log / 2.0)
    return float(np.sqrt(piece[3] * piece[4] / 2.0 * strength))
