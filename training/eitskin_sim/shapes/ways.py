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


def ways_of(pieces: Array, free: npt.NDArray[np.bool_], mesh: TensorMesh) -> Ways:
    """Return the moves that derivatives by the (n, 7) free parameters of (n, 8) touches are made of."""
    values, number = parameters_of(pieces), np.cumsum(free.ravel()).reshape(free.shape) - 1
    boxes = _boxes(pieces)
    touch, rows, steps, spans = [], [], [], []
    places: list[tuple[int, int, float]] = []  # move, parameter, share

    def add(one: int, row: Array, step: float, box: Array) -> None:
        touch.append(one)
        rows.append(row)
        steps.append(step)
        spans.append(box)

    for one, own in enumerate(free):
        sharp = pieces[one, 0] == RECTANGLE and pieces[one, 5] == 0.0 and pieces[one, 7] == 0.0 and not own[ANGLE]
        sides = sharp and bool(own[X : HALF_LENGTH + 2].all())
        for axis in (0, 1) if sides else ():
            for way in (-1.0, 1.0):
                row, box = values[one].copy(), boxes[one].copy()
                row[X + axis] += 0.5 * way * STEP
                row[HALF_LENGTH + axis] += 0.5 * STEP
                side = values[one, X + axis] + way * values[one, HALF_LENGTH + axis]
                box[:, axis] = side - BAND_MM, side + BAND_MM
                places.append((len(rows), int(number[one, X + axis]), way))
                places.append((len(rows), int(number[one, HALF_LENGTH + axis]), 1.0))
                add(one, row, STEP, box)
        for which in np.flatnonzero(own):
            if sides and which < HALF_LENGTH + 2:
                continue
            row, step = values[one].copy(), _sign(pieces[one], int(which)) * STEP
            row[which] += step
            places.append((len(rows), int(number[one, which]), 1.0))
            add(one, row, step, boxes[one])
    mix = np.zeros((len(rows), int(free.sum())))
    for move, parameter, share in places:
        mix[move, parameter] = share
    moved = pieces_of(pieces[touch, 0], np.array(rows).reshape(-1, values.shape[1]))
    reach = reached(np.array(spans).reshape(-1, 2, 2), mesh)
    return Ways(np.array(touch, dtype=np.intp), moved, np.array(steps), reach, mix)


def neighbours(pieces: Array, mesh: TensorMesh) -> list[Index]:
    """Return for every touch those that share an element with it, itself among them."""
    reach = reached(_boxes(pieces), mesh).astype(np.float32)
    return [np.flatnonzero(row) for row in reach @ reach.T > 0.0]


def reached(boxes: Array, mesh: TensorMesh) -> npt.NDArray[np.bool_]:
    """Return (n, n_elements) which elements meet (n, 2, 2) boxes, low and high corner each."""
    x, y = mesh.x_lines_mm, mesh.y_lines_mm
    across = (x[1:] > boxes[:, 0, :1]) & (x[:-1] < boxes[:, 1, :1])
    up = (y[1:] > boxes[:, 0, 1:]) & (y[:-1] < boxes[:, 1, 1:])
    return np.asarray((up[:, :, None] & across[:, None, :]).reshape(len(boxes), -1))


def _boxes(pieces: Array) -> Array:
    """Return (n, 2, 2) the boxes around touches and their borders."""
    half = half_extents_mm(pieces) + pieces[:, 7:8] / 2 + 10.0 * BAND_MM
    return np.stack([pieces[:, 1:3] - half, pieces[:, 1:3] + half], axis=1)


def _sign(piece: Array, parameter: int) -> float:
    """Return which way a parameter may go: a border not beyond its bounds, nor a width below the border."""
    return -1.0 if parameter == BORDER and piece[7] > LEAST_BORDER_MM + STEP else 1.0
