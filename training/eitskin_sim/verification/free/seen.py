"""Where physics and the network tell different things: touches that only one of them sees.

A sheet that is not quite the model's leaves a residual, and a further touch in the right place takes part of it away.
So a touch that only physics sees must answer much, or it is none. And a touch that the network sees plainly may not be
left out without a word.
"""

from typing import Final

import numpy as np

from eitskin_proto.skin.grid import Grid
from eitskin_sim.scene.touch_table import Array, cover, pixel_lines
from eitskin_sim.verification.free.found import map_of

SEEN: Final = 0.2
"""Share of a touch that must be in the other's map."""

PLAIN: Final = 3.0
"""Pixels that a touch of the network's map has at least, or it may be left out."""

DECISIVE: Final = 50.0
"""Chi-squared that a touch which the network does not show must take away, to be believed."""


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


def left_out(pieces: Array, shares: Array, grid: Grid) -> bool:
    """Return whether touches lack one that the network shows plainly; see :func:`unseen`."""
    plain = shares[shares.sum(axis=(1, 2)) >= PLAIN]
    covered = np.einsum("nrc,rc->n", plain, map_of(pieces, grid))
    return bool(np.any(covered < SEEN * plain.sum(axis=(1, 2))))
