"""Weights the maps of the verifier and of the network by their uncertainties.

Both are estimates of one map whose errors are independent in part, so each counts by the inverse of its squared error.
The verifier's uncertainty is that of the fitted touches, drawn: a border that may be anywhere within a millimetre. The
network states its own uncertainty: a value between 0 and 1.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.grid import Grid
from eitskin_sim.scene.touch_table import cover, pixel_lines
from eitskin_sim.shapes.parameters import HALF_LENGTH, HALF_WIDTH, parameters_of, pieces_of
from eitskin_sim.verification.constants import MIN_HALF_SIDE_MM
from eitskin_sim.verification.shape_verdict import ShapeVerdict

Array = npt.NDArray[np.float64]

MIN_NETWORK_SHARE: Final = 0.1
"""The network's share of a map of touches that are known exactly: touches may be no rectangles nor ellipses."""

ERROR_PER_DOUBT: Final = 0.5
"""Root of the network's squared error over what its values' own doubt is, v (1 - v), added up: 0.32 of hard squares to
0.55 of pairs, as a pixel that a border cuts is between 0 and 1 without doubt."""

MIN_SQUARE: Final = 1e-12
"""A squared error below which there is none."""

MAP_DRAWS: Final = 16
"""Of touches as they may be."""


def network_share(verdict: ShapeVerdict, image: Array, shown: int, grid: Grid) -> float:
    """Return the network's share of a map, from ``MIN_NETWORK_SHARE`` to 1, which it is of a flagged frame.

    With p and n the relative errors of physics' map and of the network's ::

        share  =  MIN_NETWORK_SHARE + (1 - MIN_NETWORK_SHARE) p^2 / (p^2 + n^2)

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
        return MIN_NETWORK_SHARE
    network = network_error(image) ** 2
    physics = map_error(verdict.pieces, verdict.scatter, grid) ** 2
    return MIN_NETWORK_SHARE + (1.0 - MIN_NETWORK_SHARE) * physics / (physics + network + MIN_SQUARE)


def network_error(image: Array) -> float:
    """Return how large the error of a network's (rows, columns) map is over the map itself, as its values say."""
    value = np.clip(image, 0.0, 1.0)
    return ERROR_PER_DOUBT * float(
        np.sqrt(np.sum(value * (1.0 - value)) / max(float(np.sum(value * value)), MIN_SQUARE))
    )


def map_error(pieces: Array, scatter: Array, grid: Grid) -> float:
    """Return how large the error of a map of touches is over the map itself, by how far their parameters may be off.

    Args:
        pieces: (n, 8) touches.
        scatter: (k, n, 7) ways in which they may be off, of one standard deviation each.
        grid: Of the map.
    """
    half = np.random.default_rng(0).standard_normal((MAP_DRAWS // 2, len(scatter)))
    off = np.tensordot(np.concatenate([half, -half]), scatter, axes=1)
    maps, lines = np.zeros((MAP_DRAWS, *grid.shape)), pixel_lines(grid)
    for number, piece in enumerate(pieces):
        values = parameters_of(piece[None]) + off[:, number]
        values[:, [HALF_LENGTH, HALF_WIDTH]] = np.maximum(values[:, [HALF_LENGTH, HALF_WIDTH]], MIN_HALF_SIDE_MM)
        for drawn, moved in zip(maps, pieces_of(np.full(MAP_DRAWS, piece[0]), values), strict=True):
            rows, columns, covered = cover(moved, *lines)
            drawn[rows, columns] += covered
    maps = np.minimum(maps, 1.0)
    return float(np.sqrt(maps.var(axis=0).sum() / max(float(np.square(maps).mean(axis=0).sum()), MIN_SQUARE)))
