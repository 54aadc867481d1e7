"""Small moves of touches that derivatives are taken by, and how those of parameters are made of them.

An upright rectangle with sharp sides moves side by side: the right one changes the elements that it crosses and no
others, and ::

    d / dx = d / d right - d / d left          d / d half length = d / d right + d / d left

with sides counted outwards. So an element is looked at for the sides that cross it, not for all parameters.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.fem.mesh import Index, TensorMesh
from eitskin_sim.scene.gap import half_extents_mm
from eitskin_sim.scene.soft_touch import LEAST_BORDER_MM
from eitskin_sim.scene.touch_table import RECTANGLE, Array
from eitskin_sim.shapes.parameters import ANGLE, BORDER, HALF_LENGTH, X, parameters_of, pieces_of

STEP: Final = 1e-5
"""mm, rad, or of log contrast."""

BAND_MM: Final = 100.0 * STEP
"""About a side, within which elements count as crossed."""

SIDES: Final = slice(X, HALF_LENGTH + 2)
"""The parameters of an upright rectangle that its sides make up."""


@dataclass(frozen=True, slots=True)
class Ways:
    """c moves of touches, and what r parameters are of them."""

    touch: Index
    """(c,) which touch moves."""
    moved: Array
    """(c, 8) the touch after it."""
    step: Array
    """(c,) how far, of either sign."""
    reach: npt.NDArray[np.bool_]
    """(c, n_elements) elements that it may change."""
    mix: Array
    """(c, r) derivatives by parameters, in the order of ``np.nonzero(free)``, from those by moves."""
    near: npt.NDArray[np.bool_]
    """(n, n) which touches share an element."""


def ways_of(pieces: Array, free: npt.NDArray[np.bool_], mesh: TensorMesh) -> Ways:
    """Return the moves that derivatives by the (n, 7) free parameters of (n, 8) touches are made of."""
    values, number = parameters_of(pieces), np.cumsum(free.ravel()).reshape(free.shape) - 1
    boxes = _boxes(pieces)
    sharp = (pieces[:, 0] == RECTANGLE) & (pieces[:, 5] == 0.0) & (pieces[:, 7] == 0.0) & ~free[:, ANGLE]
    by_sides = sharp & free[:, SIDES].all(axis=1)
    others = free.copy()
    others[by_sides, SIDES] = False
    own = reached(boxes, mesh)

    side_of = np.repeat(np.flatnonzero(by_sides), 4)  # a touch's left, right, low and high side
    sides, at = values[side_of], np.arange(len(side_of))
    axis, outward = at // 2 % 2, at % 2 * 2 - 1
    where = sides[at, X + axis] + outward * sides[at, HALF_LENGTH + axis]
    sides[at, X + axis] += 0.5 * outward * STEP
    sides[at, HALF_LENGTH + axis] += 0.5 * STEP
    crossed = boxes[side_of]
    crossed[at, :, axis] = where[:, None] + (-BAND_MM, BAND_MM)

    one_of, which = np.nonzero(others)
    steps, moved = _steps(pieces[one_of], which), values[one_of]
    moved[np.arange(len(one_of)), which] += steps

    touch = np.concatenate([side_of, one_of])
    mix = np.zeros((len(touch), int(free.sum())))
    mix[at, number[side_of, X + axis]] = outward
    mix[at, number[side_of, HALF_LENGTH + axis]] = 1.0
    mix[len(at) + np.arange(len(one_of)), number[one_of, which]] = 1.0
    return Ways(
        touch=touch,
        moved=pieces_of(pieces[touch, 0], np.concatenate([sides, moved])),
        step=np.concatenate([np.full(len(at), STEP), steps]),
        reach=np.concatenate([reached(crossed, mesh), own[one_of]]),
        mix=mix,
        near=_sharing(own),
    )


def _sharing(reach: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return (n, n) which of n touches that reach (n, n_elements) share an element."""
    counted = reach.astype(np.float32)
    return np.asarray(counted @ counted.T > 0.0)


def reached(boxes: Array, mesh: TensorMesh) -> npt.NDArray[np.bool_]:
    """Return (n, n_elements) which elements meet (n, 2, 2) boxes, low and high corner each."""
    x, y = mesh.x_lines_mm, mesh.y_lines_mm
    across = (x[1:] > boxes[:, 0, :1]) & (x[:-1] < boxes[:, 1, :1])
    up = (y[1:] > boxes[:, 0, 1:]) & (y[:-1] < boxes[:, 1, 1:])
    return np.asarray((up[:, :, None] & across[:, None, :]).reshape(len(boxes), mesh.n_elements))


def _boxes(pieces: Array) -> Array:
    """Return (n, 2, 2) the boxes around touches and their borders."""
    half = half_extents_mm(pieces) + pieces[:, 7:8] / 2 + 10.0 * BAND_MM
    return np.stack([pieces[:, 1:3] - half, pieces[:, 1:3] + half], axis=1)


def _steps(pieces: Array, which: Index) -> Array:
    """Return (c,) steps of one parameter each: a border does not go beyond its bounds, nor a width below the border."""
    down = (which == BORDER) & (pieces[:, 7] > LEAST_BORDER_MM + STEP)
    return np.where(down, -STEP, STEP)
