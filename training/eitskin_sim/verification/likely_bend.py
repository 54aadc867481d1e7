"""From a shape that voltages show to a deformation of the skin's family.

Voltages see the metric alone, and many deformations have nearly the same: a sheet that is bent without a twist shows no
angle. Of those that explain a frame, the one nearest to flat is taken. With modes' columns C and the frame's whitened
rows, its parameters q minimise ::

    |white(frame - touches - C z(q))|^2 + sum of ((q - flat) / range)^2       z(q) the metric's amplitudes

in which touches and the layer's own changes are free.
"""

from dataclasses import asdict
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from eitskin_sim.arrays import Array
from eitskin_sim.scene.family import bounds
from eitskin_sim.scene.parts import Bend
from eitskin_sim.verification.fit import Fit
from eitskin_sim.verification.metric_family import MetricFamily
from eitskin_sim.verification.residual import Noise, Whitener
from eitskin_sim.verification.touch_prior import fitted_parameters
from eitskin_sim.verification.verdict import LEVEL, p_value

OFF_FAMILY: Final = 0.2
"""Standard deviation by which a sheet's amplitudes may be off those of the family's nearest deformation."""

FREE: Final = 10.0
"""Standard deviation of touches' parameters, in mm and in logarithms of contrast: none."""

STARTS: Final = 4
"""Drawn deformations to start from, the nearest first, until one leaves as little as noise does."""


def likely_bend(fit: Fit, reference: Array, noise: Noise) -> Bend | None:
    """Return the likely deformation of a sheet; None if the family has none like it.

    Args:
        fit: Of a frame on a shape of the skin's family.
        reference: (104,) V.
        noise: Of the frame.
    """
    model, change = fit.frame.model, fit.frame.change
    family = model.shape
    assert isinstance(family, MetricFamily), "the shape of a scan is known"
    columns = model.unseen.columns / model.flat_V[:, None] * model.ratio(change)[:, None]
    own, layer = np.split(columns, [model.unseen.n_waves], axis=1)
    touches = model.jacobian(fit.solved, fitted_parameters(fit.pieces, fit.turning))
    shared = np.zeros((len(change), 0)) if noise.shared is None else noise.shared
    unknown = np.hstack([OFF_FAMILY * own, layer, FREE * touches, shared])
    white = Whitener(noise.sd(change, reference), unknown, 1.0 + change, fit.frame.white.rows)
    target = white.whiten(change - model.change(fit.solved) + columns @ model.held)
    by = white.whiten(own.T).T

    ranges = bounds(model.skin.deformations)
    flat = {**asdict(Bend()), "axis_deg": np.mean(ranges["axis_deg"])}
    middle = np.array([flat[name] for name in ranges])
    reach = np.abs(np.array(list(ranges.values())) - middle[:, None]).max(axis=1)
    free = reach > 0.0

    def bend_at(values: Array) -> Bend:
        found = middle.copy()
        found[free] += values * reach[free]
        return Bend(*found.tolist())

    def left(values: Array) -> Array:
        return np.concatenate([by @ family.amplitudes(bend_at(values)) - target, values])

    best, lowest = None, np.inf
    for number in np.argsort(np.linalg.norm(family.drawn @ by.T - target, axis=1))[:STARTS]:
        drawn = np.array([getattr(family.bends[number], name) for name in ranges])
        found = least_squares(left, ((drawn - middle) / reach)[free], bounds=(-1.0, 1.0), ftol=1e-3)
        bend, chi_squared = bend_at(found.x), float(np.sum(np.square(found.fun[: len(target)])))
        if chi_squared < lowest:
            best, lowest = bend, chi_squared
        if lowest < len(white):
            break
    return best if p_value(lowest, len(white)) > LEVEL else None
