"""Other touches that might explain a frame better: where a search goes on while physics is not satisfied.

::

    add       where a small touch would answer most of the residual, of either sign
    remove    each touch
    split     a touch in two, along or across
    merge     two neighbours in one
    soften    graded borders for all, or sharp ones
    round     a rectangle as an ellipse, and the other way round
    turn      angles are fitted from now on
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import Final

import numpy as np

from eitskin_proto.skin.skin import Skin
from eitskin_sim.scene.touch_table import ELLIPSE, RECTANGLE, Array
from eitskin_sim.shapes.parameters import areas_mm2
from eitskin_sim.verification.free.fit import Fit, Frame

WINDOW_MM: Final = 10.0
"""Diameter of the touch that is looked for."""

GRID_MM: Final = 5.0
"""Of its places."""

NEAR_MM: Final = 12.0
"""Gap up to which two touches may be one."""

BORDER_MM: Final = 2.5
"""Of a border that is tried."""

Move = tuple[str, Array, bool]
"""Name, (n, 8) touches to start from, whether angles are fitted."""


@lru_cache(maxsize=4)
def _places(skin: Skin) -> Array:
    x, y = (np.arange(GRID_MM / 2, extent, GRID_MM) for extent in skin.outline.size_mm)
    return np.stack([one.ravel() for one in np.meshgrid(x, y)], axis=-1)


def additions(frame: Frame, fit: Fit, most: int = 2) -> list[Array]:
    """Return (8,) touches that would answer most of what a fit leaves."""
    model = frame.model
    mesh = model.touched.sheet.system.mesh
    places = _places(model.skin)
    apart = np.hypot(*(places[:, None, :] - mesh.centres_mm[None, :, :]).transpose(2, 0, 1))
    share = np.clip((WINDOW_MM / 2 + 2.0 - apart) / 4.0, 0.0, 1.0)
    scale = np.clip((1.0 + frame.change) / (1.0 + model.untouched), 0.2, 4.0)
    answer = frame.white.whiten((share @ model.unseen.by_log_sigma) * scale / model.flat_V)
    size = np.einsum("pr,pr->p", answer, answer)
    amount = answer @ fit.residual / size
    gain = amount * amount * size
    taken = np.zeros(len(places), dtype=np.bool_)
    for piece in fit.pieces:
        taken |= np.hypot(*(places - piece[1:3]).T) < 0.4 * piece[3:5].max() + 2.0
    gain[taken] = 0.0
    gain[frame.usual.sign * amount < 0.0] = 0.0
    found = []
    for _ in range(most):
        at = int(np.argmax(gain))
        if gain[at] <= 0.0:
            break
        found.append(_small(frame, fit, places[at], float(amount[at])))
        gain[np.hypot(*(places - places[at]).T) < 15.0] = 0.0
    return found


def _small(frame: Frame, fit: Fit, at: Array, amount: float) -> Array:
    """Return a touch of a log contrast that the others, or touches of this skin, have, if its sign is theirs."""
    usual = np.log(fit.pieces[:, 6]).mean() if len(fit.pieces) else frame.usual.log_contrast
    log = usual if usual * amount > 0.0 else float(np.clip(amount, -1.5, 2.0))
    if amount > 0.0 and not len(fit.pieces):
        log = float(np.clip(1.5 * amount, 0.3, 3.9))
    return np.array([RECTANGLE, *at, WINDOW_MM, WINDOW_MM, 0.0, np.exp(log if abs(log) > 0.1 else 0.1), 0.0])


def moves(frame: Frame, fit: Fit) -> Iterator[Move]:
    """Yield what else might be tried, the likeliest first."""
    pieces, turning = fit.pieces, fit.turning
    n = len(pieces)
    for piece in additions(frame, fit, 2 if n else 4):
        yield "add", np.vstack([pieces, piece]), turning
    if not n:
        return
    for number in np.argsort(-areas_mm2(pieces))[:3]:
        for halves in _halves(pieces[number]):
            yield "split", np.vstack([np.delete(pieces, number, axis=0), halves]), turning
    for i in range(n):
        for j in range(i):
            gap = np.hypot(*(pieces[i, 1:3] - pieces[j, 1:3])) - (pieces[i, 3:5].min() + pieces[j, 3:5].min()) / 2
            if gap < NEAR_MM and pieces[i, 0] == pieces[j, 0]:
                yield "merge", np.vstack([np.delete(pieces, [i, j], axis=0), _both(pieces[i], pieces[j])]), turning
    soft = pieces.copy()
    soft[:, 7] = np.where(pieces[:, 7] > 0.0, 0.0, np.minimum(BORDER_MM, pieces[:, 3:5].min(axis=1)))
    yield "soften", soft, turning
    round_ = pieces.copy()
    round_[:, 0] = np.where(pieces[:, 0] == RECTANGLE, ELLIPSE, RECTANGLE)
    round_[:, 3:5] *= np.where(pieces[:, :1] == RECTANGLE, 1.13, 1.0 / 1.13)
    yield "round", round_, turning
    if not turning:
        for degrees in (20.0, -20.0, 45.0):
            turned = pieces.copy()
            turned[:, 5] += degrees
            yield "turn", turned, True
    if n > 1:
        for number in np.argsort(areas_mm2(pieces))[:4]:
            yield "remove", np.delete(pieces, number, axis=0), turning


def _halves(piece: Array) -> list[Array]:
    """Return a touch as two, along and across, a little apart."""
    found = []
    for axis in np.argsort(-piece[3:5]):
        turn = np.deg2rad(piece[5]) + axis * np.pi / 2
        direction = np.array([np.cos(turn), np.sin(turn)])
        two = np.vstack([piece, piece])
        two[:, 3 + axis] *= 0.42
        two[:, 1:3] += np.outer([-0.28, 0.28], direction) * piece[3 + axis]
        two[:, 7] = np.minimum(two[:, 7], two[:, 3:5].min(axis=1))
        found.append(two)
    return found


def _both(one: Array, other: Array) -> Array:
    """Return one touch in place of two: the box around them."""
    low = np.minimum(one[1:3] - one[3:5] / 2, other[1:3] - other[3:5] / 2)
    high = np.maximum(one[1:3] + one[3:5] / 2, other[1:3] + other[3:5] / 2)
    contrast = np.exp((np.log(one[6]) + np.log(other[6])) / 2)
    border = min(one[7], other[7])
    if abs(np.log(contrast)) < 0.1:
        contrast = one[6]
    return np.array([one[0], *(low + high) / 2, *(high - low), 0.0, contrast, border])
