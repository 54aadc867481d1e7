"""How much of a map is physics', and how much the network's: each by what it does not know.

Both are estimates of one map whose errors are independent in part, so each counts by the inverse of its squared error.
What physics does not know is how touches may be off, drawn: a border that may lie anywhere within a millimetre. What
the network does not know it says itself: a value between 0 and 1.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.grid import Grid
from eitskin_sim.scene.touch_table import RECTANGLE, cover, pixel_lines
from eitskin_sim.shapes.parameters import HALF_LENGTH, HALF_WIDTH, parameters_of, pieces_of
from eitskin_sim.verification.constants import MIN_HALF_SIDE_MM
from eitskin_sim.verification.shape_verdict import ShapeVerdict

Array = npt.NDArray[np.float64]

LEAST_SHARE: Final = 0.1
"""The network's share of a map of touches that are known exactly: touches may be no rectangles nor ellipses."""

ERRS: Final = 0.5
"""Root of the network's squared error over what its values' own doubt is, v (1 - v), added up: 0.32 of hard squares to
0.55 of pairs, as a pixel that a border cuts is between 0 and 1 without doubt."""

LEAST: Final = 1e-12
"""A squared error below which there is none."""

DRAWS: Final = 16
"""Of touches as they may be."""


def network_share(verdict: ShapeVerdict, image: Array, shown: int, grid: Grid) -> float:
    """Return the network's share of a map, from ``LEAST_SHARE`` to 1, which it is of a flagged frame.

    With p and n the relative errors of physics' map and of the network's ::

        share  =  LEAST_SHARE + (1 - LEAST_SHARE) p^2 / (p^2 + n^2)

    A network that shows fewer touches than there are has the least: it errs in more than it says.

    Args:
        verdict: What physics says.
        image: (rows, columns) the network's map.
        shown: How many touches the network shows.
        grid: Of the map.
    """
    if verdict.flagged:
        return 1.0
    if shown < verdict.bodies or not len(verdict.pieces):
        return LEAST_SHARE
    network = network_error(image) ** 2
    physics = map_error(verdict.pieces, verdict.scatter, grid) ** 2
    return LEAST_SHARE + (1.0 - LEAST_SHARE) * physics / (physics + network + LEAST)


def network_error(image: Array) -> float:
    """Return how large the error of a network's (rows, columns) map is over the map itself, as its values say."""
    value = np.clip(image, 0.0, 1.0)
    return ERRS * float(np.sqrt(np.sum(value * (1.0 - value)) / max(float(np.sum(value * value)), LEAST)))


def map_error(pieces: Array, scatter: Array, grid: Grid) -> float:
    """Return how large the error of a map of touches is over the map itself, by how far their parameters may be off.

    Args:
        pieces: (n, 8) touches.
        scatter: (k, n, 7) ways in which they may be off, of one standard deviation each.
        grid: Of the map.
    """
    half = np.random.default_rng(0).standard_normal((DRAWS // 2, len(scatter)))
    off = np.tensordot(np.concatenate([half, -half]), scatter, axes=1)
    maps = np.zeros((DRAWS, *grid.shape))
    for number, piece in enumerate(pieces):
        values = parameters_of(piece[None]) + off[:, number]
        values[:, [HALF_LENGTH, HALF_WIDTH]] = np.maximum(values[:, [HALF_LENGTH, HALF_WIDTH]], MIN_HALF_SIDE_MM)
        maps += _covers(pieces_of(np.full(DRAWS, piece[0]), values), grid)
    maps = np.minimum(maps, 1.0)
    return float(np.sqrt(maps.var(axis=0).sum() / max(float(np.square(maps).mean(axis=0).sum()), LEAST)))


def _covers(pieces: Array, grid: Grid) -> Array:
    """Return (n, rows, columns) the covered share of every pixel, of each touch alone."""
    lines = pixel_lines(grid)
    if np.all(pieces[:, 0] == RECTANGLE) and not np.any(pieces[:, 5]):
        x, y = (
            np.clip(
                np.minimum(line[1:], pieces[:, 1 + axis, None] + pieces[:, 3 + axis, None] / 2)
                - np.maximum(line[:-1], pieces[:, 1 + axis, None] - pieces[:, 3 + axis, None] / 2),
                0.0,
                None,
            )
            / np.diff(line)
            for axis, line in enumerate(lines)
        )
        return np.asarray(y[:, :, None] * x[:, None, :])
    found = np.zeros((len(pieces), *grid.shape))
    for number, piece in enumerate(pieces):
        rows, columns, share = cover(piece, *lines)
        found[number, rows, columns] = share
    return found
