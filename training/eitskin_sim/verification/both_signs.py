"""Touches of both signs at once: signs that the voltages ask for, and touches that a network of one sign does not show.

To first order a touch answers as the sheet's conductivity does, changed where it is. So the signs of some touches are
those of their amplitudes, fitted linearly, and one more touch is where this response explains most of what a fit leaves
of a frame, beside all that the fit's own touches could still explain.
"""

import numpy as np
from scipy.spatial.distance import cdist

from eitskin_sim.arrays import Array
from eitskin_sim.scene.touch_table import RECTANGLE
from eitskin_sim.verification import constants as c
from eitskin_sim.verification.fit import Fit, Frame
from eitskin_sim.verification.network_map import of_signs


def signed(frame: Frame, pieces: Array) -> Array:
    """Return touches (n, 8) of the usual contrasts of those signs that a frame asks for."""
    if not len(pieces):
        return pieces
    responses = _responses(frame, pieces[:, 1:3], np.sqrt(pieces[:, 3] * pieces[:, 4]))
    left = frame.white.whiten(frame.change - frame.expected - frame.model.untouched)
    amplitudes = np.linalg.lstsq(responses.T, left, rcond=1e-3)[0]
    return of_signs(pieces, np.sign(amplitudes), frame.prior)


def with_another(fit: Fit) -> Array:
    """Return the (n + 1, 8) touches of a fit and one more, where it explains most of what the fit leaves."""
    frame, skin, size_mm = fit.frame, fit.frame.model.skin, fit.frame.prior.size_mm
    x, y = (np.arange(c.PLACES_MM / 2.0, extent, c.PLACES_MM) for extent in skin.grid.size_mm)
    places = np.stack([one.ravel() for one in np.meshgrid(x, y)], axis=-1)
    responses = _responses(frame, places, np.full(len(places), size_mm))
    whole = np.sum(responses**2, axis=1)
    if len(fit.pieces):
        own, _ = np.linalg.qr(fit.linear[1][: len(fit.residual)])
        responses = responses - (responses @ own) @ own.T
    left = np.maximum(np.sum(responses**2, axis=1), c.MIN_SHARE_BESIDE * whole)
    projected = responses @ fit.residual
    best = np.argmax(projected**2 / left)
    sign = np.sign(projected[best : best + 1])
    polarity = 2.0 * np.tanh(np.abs(frame.prior.usual(sign)) / 2.0)  # of a small disc, as log conductivity goes
    side = size_mm * np.sqrt(np.abs(projected[best]) / left[best] / polarity)
    sides = np.clip(side, *c.SIDES_OF_ANOTHER_MM)
    piece = np.array([[RECTANGLE, *places[best], *np.tile(sides, 2), 0.0, 1.0, 0.0]])
    return np.concatenate([fit.pieces, of_signs(piece, sign, frame.prior)])


def _responses(frame: Frame, places_mm: Array, sides_mm: Array) -> Array:
    """Return the (n, kept rows) whitened response to log conductivity at places (n, 2), each as wide as (n,)."""
    model = frame.model
    centres = model.touched.sheet.system.mesh.centres_mm
    weight = np.exp(cdist(places_mm, centres, "sqeuclidean") / (-(sides_mm[:, None] ** 2) / 6.0))
    by = weight @ model.unseen.by_log_sigma / model.flat_V * model.ratio(frame.change)
    return np.asarray(frame.white.whiten(by))
