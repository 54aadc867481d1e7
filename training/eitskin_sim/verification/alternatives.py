"""Other touches that may explain a frame better than those that a fit found, each compared by cost.

Size and contrast form a long valley of the cost with short steps, so touches of usual contrast are tried directly. A
finger is round, so ellipses are tried in place of rectangles that do not explain a frame. Two near touches read nearly
like one large touch, and on a poorly known sheet also like one between them, so two are tried in place of one.

Each function returns the given fit if nothing is better or time is over.
"""

from dataclasses import replace

import numpy as np

from eitskin_sim.arrays import Array
from eitskin_sim.scene.gap import gap_mm
from eitskin_sim.scene.touch_table import ELLIPSE, RECTANGLE
from eitskin_sim.shapes.parameters import areas_mm2
from eitskin_sim.verification import constants as c
from eitskin_sim.verification.fit import IMPOSSIBLE_TOUCH_ERRORS, Budget, Fit, Frame, refine
from eitskin_sim.verification.network_map import (
    ELLIPSE_SIDES_OF_RECTANGLE,
    joints_of,
    shown_as_large,
    without_cracks,
)


def fitted(frame: Frame, pieces: Array, turning: bool, budget: Budget, below: float = np.inf) -> Fit | None:
    """Return touches fitted to a frame; None where the sheet cannot have them.

    Args:
        frame: The frame.
        pieces: (n, 8) where to start.
        turning: Whether angles are fitted.
        budget: Of the frame.
        below: The cost that is of use.
    """
    budget.fits += 1
    try:
        return refine(frame, frame.at(pieces, turning), c.MAX_STEPS, budget.search_over, below=below)
    except IMPOSSIBLE_TOUCH_ERRORS:
        return None


def _cheaper(frame: Frame, fit: Fit, pieces: Array, budget: Budget, by: float = 0.0) -> Fit:
    """Return the fit, or one from other touches, if that costs less by as much."""
    other = fitted(frame, pieces, fit.turning, budget, fit.cost - by)
    return other if other is not None and other.cost < fit.cost - by else fit


def of_usual_contrast(frame: Frame, fit: Fit, budget: Budget) -> Fit:
    """Return the fit, or one from touches of usual contrast that are as strong, if that costs less."""
    log = np.log(fit.pieces[:, 6])
    usual = frame.prior.usual(log)
    if budget.search_over() or not len(log) or abs(np.mean(usual - log)) < c.MIN_LOG_RATIO_TO_USUAL_CONTRAST:
        return fit
    return _cheaper(frame, fit, scaled_to_contrast(fit.pieces, usual), budget)


def scaled_to_contrast(pieces: Array, log_contrasts: Array) -> Array:
    """Return touches of other contrasts (n,) and sizes, which read alike as long as they are small.

    A small disc of contrast c answers as (c - 1) / (c + 1) = tanh(log c / 2) times its area.
    """
    found = pieces.copy()
    area_ratio, most = np.tanh(np.log(pieces[:, 6]) / 2.0) / np.tanh(log_contrasts / 2.0), c.MAX_AREA_RATIO_OF_RESCALED
    found[:, 3:5] *= np.sqrt(np.clip(area_ratio, 1.0 / most, most))[:, None]
    found[:, 6] = np.exp(log_contrasts)
    found[:, 7] = np.minimum(found[:, 7], found[:, 3:5].min(axis=1) - 0.01)
    return found


def as_ellipses(frame: Frame, fit: Fit, budget: Budget) -> Fit:
    """Return the fit, or one with ellipses in place of its rectangles, if that costs less."""
    if not (fit.pieces[:, 0] == RECTANGLE).any() or fit.explains or budget.search_over():
        return fit
    pieces = fit.pieces.copy()
    pieces[:, 0] = ELLIPSE
    pieces[:, 3:5] *= ELLIPSE_SIDES_OF_RECTANGLE
    return _cheaper(frame, fit, pieces, budget)


def two_in_place_of_one(frame: Frame, fit: Fit, shares: Array, budget: Budget) -> Fit:
    """Return the fit, or one with two touches in place of the largest, if that costs less.

    Args:
        frame: The frame.
        fit: Of it.
        shares: (n, rows, columns) of the network's map.
        budget: Of the frame.
    """
    if not len(fit.pieces) or budget.search_over():
        return fit
    largest = int(np.argmax(areas_mm2(fit.pieces)))
    piece = fit.pieces[largest]
    along = int(np.argmax(piece[3:5]))
    log = float(np.log(piece[6]))
    usual = float(frame.prior.usual(np.array(log)))
    weak = abs(usual) - abs(log) > c.MIN_LOG_RATIO_OF_WEAK_TOUCH
    if piece[3 + along] < c.MIN_ASPECT_OF_TWO * piece[4 - along]:
        return fit
    if fit.explains and shown_as_large(piece, shares, frame.model.skin.grid):
        return fit
    two = np.vstack([piece, piece])
    if weak:
        log, two[:, 6] = usual, np.exp(usual)
    strength = np.tanh(np.log(piece[6]) / 2.0) / np.tanh(log / 2.0)
    side = float(np.sqrt(piece[3] * piece[4] / 2.0 * strength))
    turn = np.deg2rad(piece[5]) + along * np.pi / 2
    two[:, 1:3] += np.outer([-0.5, 0.5], [np.cos(turn), np.sin(turn)]) * (side + c.GAP_OF_TWO_MM)
    two[:, 3:5], two[:, 7] = side, np.minimum(two[:, 7], side - 0.01)
    over = gap_mm(np.tile(piece, (len(fit.pieces), 1)), fit.pieces) < -c.OVERLAP_MM
    over[largest] = True  # a thin one overlaps itself by less
    return _cheaper(frame, fit, np.vstack([fit.pieces[~over], two]), budget, 0.0 if weak else c.MIN_GAIN_OF_TWO)


def without_smallest(frame: Frame, fit: Fit, budget: Budget) -> Fit:
    """Return the fit, or one without its smallest touch, if that has shrunk to next to nothing and costs less so."""
    areas = areas_mm2(fit.pieces)
    if len(areas) < 2 or areas.min() > c.MAX_AREA_OF_GHOST_MM2 or budget.search_over():
        return fit
    return _cheaper(frame, fit, np.delete(fit.pieces, np.argmin(areas), axis=0), budget)


def as_one_body(frame: Frame, fit: Fit, shares: Array, budget: Budget) -> Fit:
    """Return the fit with what the network shows as one touch made one body, unless the frame speaks against it.

    Its frame has the joints then: errors and other contrasts are those of the body.
    """
    grid = frame.model.skin.grid
    joints = joints_of(fit.pieces, shares, grid)
    if not joints or budget.search_over():
        return fit
    pieces = without_cracks(fit.pieces, shares, grid)
    for _ in joints:  # a chain evens out
        for pair in joints:
            pieces[list(pair), 6] = np.exp(np.log(pieces[list(pair), 6]).mean())
    body = fitted(replace(frame, joints=joints), pieces, fit.turning, budget)
    if body is None or body.chi_squared - fit.chi_squared >= c.MAX_CHI2_PER_JOINT * len(joints):
        return fit
    return body
