"""Other contrasts that explain a frame as well: where data tell only the product of a touch's size and contrast.

A disc of contrast c answers as (c - 1) / (c + 1) times its area, as long as it is small: 28 mm2 of contrast 50 read as
100 mm2 of contrast 2 do, to a tenth of chi-squared. A skin's file says which contrasts its touches have; but a touch
that begins has a lower one, however the skin is made. So a share of belief goes to gentler touches, and how much of it
stays is decided by the sizes that they would have, and by what they leave unexplained. The map is drawn from all of
them, each by its share: what is sure is drawn full, and what depends on the contrast is drawn in part.

They are followed from the touches that were found, a contrast at a time, each from the one before.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from eitskin_sim.scene.touch_table import Array
from eitskin_sim.shapes.parameters import COUNT, HALF_LENGTH, HALF_WIDTH, areas_mm2
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.fit import Fit, Frame, held_prior, refine
from eitskin_sim.verification.free.found import Likely
from eitskin_sim.verification.free.improve import IMPOSSIBLE

GENTLE: Final = ((1.5, 0.1), (2.0, 0.1), (3.0, 0.1), (5.0, 0.1))
"""Contrasts below those that a skin states of touches that raise conductance, and the shares of belief of each."""

LARGER: Final = ((2.0, 0.05), (3.0, 0.05))
"""The same of touches that would be larger than :data:`PLAIN_MM` with the skin's contrast."""

LOWERING: Final = ((0.7, 0.4),)
"""The same of touches that lower conductance: gentler ones are nearer to 1."""

HELD_SD: Final = 0.05
"""Of the log contrast about one that is looked at."""

APART: Final = 0.2
"""Log contrasts that differ by less are one."""

PLAIN_MM: Final = 8.5
"""Root of the area from which a touch of contrast 50 reads otherwise than any of contrast 5."""

LARGE_MM: Final = 20.0
"""The same of contrast 2, of twice the side: beyond it a touch's size shows. It is asked of a touch that is alone."""

STEPS: Final = 3
"""Steps of each, from the touches of the contrast before: with fewer, gentler ones are believed too little."""

FAR: Final = 8.0
"""What costs so much more, even if a step keeps its promise, is left, and gentler ones with it."""

LEAST: Final = 0.02
"""A smaller share of belief is none."""


def likely(frame: Frame, fit: Fit, effort: Effort) -> Likely:
    """Return a fit's touches, and those of other contrasts that explain a frame as well."""
    own = ((1.0, fit.pieces),)
    mean = float(np.log(fit.pieces[:, 6]).mean()) if len(fit.pieces) else 0.0
    others = [one for one in _gentler(frame, fit.pieces) if abs(np.log(one[0]) - mean) > APART]
    if not others:
        return own
    tried = [(1.0 - sum(share for _, share in others), _unlikely(fit), fit.pieces)]
    for towards in (1.0, -1.0):
        before: Fit | None = fit
        for contrast, share in sorted(others, key=lambda one: towards * one[0]):
            if towards * (np.log(contrast) - mean) < 0.0:
                continue
            if before is None or effort.searched():
                break
            before = _held(frame, fit, before, contrast, effort)
            if before is not None:
                tried.append((share, _unlikely(before), before.pieces))
    least = min(cost for _, cost, _ in tried)
    belief = np.array([share * np.exp(-0.5 * (cost - least)) for share, cost, _ in tried])
    belief[1:][belief[1:] < LEAST * belief.sum()] = 0.0
    belief /= belief.sum()
    return tuple((float(one), pieces) for one, (_, _, pieces) in zip(belief, tried, strict=True) if one > 0.0) or own


def _held(frame: Frame, own: Fit, before: Fit, contrast: float, effort: Effort) -> Fit | None:
    """Return touches fitted with their mean contrast held, from those of a contrast before; None where that is far.

    Touches that are scaled by their contrast answer to their places, and by the logarithm to their sides, as before.

    Args:
        frame: The frame.
        own: The touches as they were fitted, whose derivatives serve.
        before: Where to start.
        contrast: That they have.
        effort: Of the frame.
    """
    at = replace(frame, usual=replace(frame.usual, log_contrast=float(np.log(contrast)), common_sd=HELD_SD))
    _, by, free = own.errors
    effort.fits += 1
    try:
        start = at.at(scaled(before.pieces, contrast), own.turning)
        scale = np.ones((len(own.pieces), COUNT))
        scale[:, [HALF_LENGTH, HALF_WIDTH]] = own.pieces[:, 3:5] / start.pieces[:, 3:5]
        by = by * scale[free]
        if start.cost - _promised(start, by) > own.cost + FAR:
            return None
        return refine(at, start, STEPS, effort.searched, by=by)
    except IMPOSSIBLE:
        return None


def _promised(fit: Fit, by: Array) -> float:
    """Return by how much a step would make what is minimised less, as (rows + p, r) derivatives from near by say."""
    residual, rate, _ = fit.residuals()
    by = np.concatenate([by[: len(fit.residual)], rate])
    step = np.linalg.lstsq(by, residual, rcond=None)[0]
    return float(residual @ residual - np.sum((residual - by @ step) ** 2))


def _gentler(frame: Frame, pieces: Array) -> tuple[tuple[float, float], ...]:
    """Return the contrasts that are looked at besides, and the share of belief of each."""
    if not len(pieces) or not frame.usual.sign:
        return ()
    if frame.usual.sign < 0:
        return LOWERING
    root_mm = float(np.sqrt(areas_mm2(pieces).min()))
    if root_mm <= PLAIN_MM:
        return GENTLE
    return LARGER if root_mm <= LARGE_MM and len(pieces) == 1 else ()


def scaled(pieces: Array, contrast: float) -> Array:
    """Return touches of a mean contrast that read alike, as long as they are small."""
    found = pieces.copy()
    log = np.log(pieces[:, 6])
    found[:, 6] = np.exp(log - log.mean() + np.log(contrast))
    found[:, 3:5] *= np.sqrt(np.clip(np.tanh(log / 2.0) / np.tanh(np.log(found[:, 6]) / 2.0), 0.2, 5.0))[:, None]
    found[:, 7] = np.minimum(found[:, 7], found[:, 3:5].min(axis=1) - 0.01)
    return found


def _unlikely(fit: Fit) -> float:
    """Return what a fit leaves, and how unlikely its sizes are: all but the mean contrast."""
    return fit.chi_squared + held_prior(fit)
