"""Gentler contrasts that explain a frame equally well, if the data show only the product of size and contrast.

A disc of contrast c answers as (c - 1) / (c + 1) times its area, as long as it is small: 28 mm2 of contrast 50 read as
100 mm2 of contrast 2 do, to a tenth of chi-squared. A skin's file says which contrasts its touches have; but a touch
that begins has a lower one on any skin. So gentler touches get a share of the probability, according to their sizes and
their residuals. The map is their mean, weighted by these shares: certain parts have full value, and parts that depend
on the contrast a lower one.

The fit is followed from contrast to contrast, each from the one before.
"""

from dataclasses import replace

import numpy as np

from eitskin_sim.arrays import Array
from eitskin_sim.shapes.parameters import HALF_LENGTH, HALF_WIDTH, N_PARAMETERS, areas_mm2
from eitskin_sim.verification import constants as c
from eitskin_sim.verification.alternatives import scaled_to_contrast
from eitskin_sim.verification.fit import IMPOSSIBLE_TOUCH_ERRORS, Budget, Fit, Frame, refine
from eitskin_sim.verification.shape_verdict import Likely


def likely_touches(frame: Frame, fit: Fit, budget: Budget) -> Likely:
    """Return a fit's touches, and those of other contrasts that explain the frame as well, with shares of belief."""
    own, others = ((1.0, fit.pieces),), _contrasts(frame, fit.pieces)
    if not others:
        return own
    mean = float(np.log(fit.pieces[:, 6]).mean())
    tried = [(1.0 - sum(share for _, share in others), fit)]
    for towards in (1.0, -1.0):
        before: Fit | None = fit
        for contrast, share in sorted(others, key=lambda one: towards * one[0]):
            if towards * (np.log(contrast) - mean) < 0.0:
                continue
            if before is None or budget.search_over():
                break
            before = _held(frame, fit, before, contrast, budget)
            if before is not None:
                tried.append((share, before))
    costs = np.array([one.chi_squared + one.prior_cost for _, one in tried])
    belief = np.array([share for share, _ in tried]) * np.exp(-0.5 * (costs - costs.min()))
    belief[1:][belief[1:] < c.MIN_SHARE_OF_BELIEF * belief.sum()] = 0.0
    belief /= belief.sum()
    kept = [(float(share), one.pieces) for share, (_, one) in zip(belief, tried, strict=True) if share > 0.0]
    return tuple(kept) or own


def _contrasts(frame: Frame, pieces: Array) -> tuple[tuple[float, float], ...]:
    """Return the contrasts that are tried beside the fit's own, each with its share of belief."""
    if not len(pieces) or not frame.prior.sign:
        return ()
    if frame.prior.sign < 0:
        return c.GENTLER_LOWERING
    root_mm = float(np.sqrt(areas_mm2(pieces).min()))
    if root_mm <= c.MAX_ROOT_AREA_OF_GENTLER_MM:
        return c.GENTLER_RAISING
    return c.LARGE_GENTLER_CONTRASTS if root_mm <= c.MAX_ROOT_AREA_OF_GENTLER_LARGE_MM and len(pieces) == 1 else ()


def _held(frame: Frame, own: Fit, before: Fit, contrast: float, budget: Budget) -> Fit | None:
    """Return touches fitted with their mean contrast held; None where the frame speaks against it.

    Touches that are scaled by their contrast answer to their places, and by the logarithm to their sides, as before.

    Args:
        frame: The frame.
        own: The touches as they were fitted, whose derivatives serve.
        before: Where to start.
        contrast: That they have.
        budget: Of the frame.
    """
    prior = replace(
        frame.prior, log_contrasts=(float(np.log(contrast)),) * 2, mean_contrast_sds=(c.HELD_CONTRAST_SD,) * 2
    )
    at = replace(frame, prior=prior)
    _, by, fitted = own.linear_nearby
    budget.fits += 1
    log = np.log(before.pieces[:, 6])
    try:
        start = at.at(scaled_to_contrast(before.pieces, log - log.mean() + np.log(contrast)), own.turning)
        scale = np.ones((len(own.pieces), N_PARAMETERS))
        scale[:, [HALF_LENGTH, HALF_WIDTH]] = own.pieces[:, 3:5] / start.pieces[:, 3:5]
        residual, by, _ = start.with_prior(by * scale[fitted])
        step = np.linalg.lstsq(by, residual, rcond=None)[0]
        promised = float(residual @ residual - np.sum((residual - by @ step) ** 2))
        if start.cost - promised > own.cost + c.MAX_COST_OF_GENTLER:
            return None
        return refine(at, start, c.STEPS_PER_CONTRAST, budget.search_over, by)
    except IMPOSSIBLE_TOUCH_ERRORS:
        return None
