"""Where physics and the network tell different things: touches that only one of them sees.

A sheet that is not quite the model's leaves a residual, and a further touch in the right place takes part of it away.
So a touch that only physics sees must answer much, or it is none.
"""

from typing import Final

import numpy as np

from eitskin_proto.skin.grid import Grid
from eitskin_sim.scene.gap import gap_mm
from eitskin_sim.scene.touch_table import RECTANGLE, Array, cover, pixel_lines
from eitskin_sim.shapes.parameters import parameters_of
from eitskin_sim.verification.free.found import map_of
from eitskin_sim.verification.free.prior.joints import Joints, crack
from eitskin_sim.verification.free.starts import starts_of

SEEN: Final = 0.2
"""Share of a touch that must be in the other's map."""

DECISIVE: Final = 50.0
"""Chi-squared that a touch must take away, to be believed, where the network shows none."""

BESIDE: Final = 300.0
"""The same of one beside those that the network shows: it seldom misses one of several, while a sheet that is not the
model's often seems to have one more, which takes 50 to 200 away. A hard touch of 10 mm takes thousands."""

ALIKE: Final = 0.25
"""Logarithm by which sides differ at most."""

CRACK_MM: Final = 3.0
"""Between two shapes of one touch: less than a pixel."""


def shown_as(piece: Array, shares: Array, grid: Grid) -> bool:
    """Return whether the network's map shows a touch as large as it was found, along and across.

    Args:
        piece: (8,) the touch.
        shares: (n, rows, columns) of the network's map.
        grid: Of the map.
    """
    if not len(shares):
        return False
    rectangles = starts_of(shares, grid)
    nearest = rectangles[np.argmin(np.hypot(*(rectangles[:, 1:3] - piece[1:3]).T))]
    sides = (np.sort(one[3:5]) for one in (nearest, piece))
    return bool(np.abs(np.log(np.divide(*sides))).max() < ALIKE)


def closed(pieces: Array, shares: Array, grid: Grid) -> Array:
    """Return touches of which those that the network shows as one have grown over cracks between them.

    An L is two rectangles, and no frame tells a crack of a millimetre between them.

    Args:
        pieces: (m, 8) touches.
        shares: (n, rows, columns) of the network's map.
        grid: Of the map.
    """
    found = pieces.copy()
    for one, other in joints_of(pieces, shares, grid):
        wide, axis = crack(parameters_of(found), (one, other))
        if wide > 0.0:
            small, large = sorted((one, other), key=lambda number: float(found[number, 3 + axis]))
            way = np.sign(found[large, 1 + axis] - found[small, 1 + axis])
            found[small, 3 + axis] += wide
            found[small, 1 + axis] += way * wide / 2.0
    return found


def joints_of(pieces: Array, shares: Array, grid: Grid) -> Joints:
    """Return which touches the network shows as one and physics less than a pixel apart, in pairs.

    Args:
        pieces: (m, 8) touches.
        shares: (n, rows, columns) of the network's map.
        grid: Of the map.
    """
    if len(pieces) < 2 or not len(shares):
        return ()
    upright = (pieces[:, 0] == RECTANGLE) & (pieces[:, 5] == 0.0)
    one, other = np.tril_indices(len(pieces), -1)
    near = upright[one] & upright[other] & (gap_mm(pieces[one], pieces[other]) < CRACK_MM)
    if not near.any():
        return ()
    owner = np.array([np.einsum("rc,nrc->n", map_of(piece[None], grid), shares).argmax() for piece in pieces])
    near &= owner[one] == owner[other]
    return tuple(zip(one[near].tolist(), other[near].tolist(), strict=True))


def together(pieces: Array, joints: Joints, shares: Array, grid: Grid) -> Array:
    """Return touches without cracks, those that hang together with their mean log contrast."""
    found = closed(pieces, shares, grid)
    for _ in joints:  # a chain evens out
        for pair in joints:
            found[list(pair), 6] = np.exp(np.log(found[list(pair), 6]).mean())
    return found


def unseen(pieces: Array, shares: Array, grid: Grid) -> list[int]:
    """Return the numbers of touches that the network does not show.

    Args:
        pieces: (m, 8) touches.
        shares: (n, rows, columns) of the network's map, what each of its touches has of every pixel.
        grid: Of the map.
    """
    shown, lines = shares.sum(axis=0), pixel_lines(grid)
    found = []
    for number, piece in enumerate(pieces):
        rows, columns, share = cover(piece, *lines)
        if np.sum(share * shown[rows, columns]) < SEEN * share.sum():
            found.append(number)
    return found
