"""Biquadratic shape functions on the unit square, and Gauss's rule of 3 x 3 points, exact to degree 5."""

from typing import Final

import numpy as np

from eitskin_sim.arrays import Array


def _rule() -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(3)
    return (nodes + 1.0) / 2, weights / 2


LINE_POINTS: Final[Array] = _rule()[0]
"""(3,) on [0, 1]."""

LINE_WEIGHTS: Final[Array] = _rule()[1]
"""(3,) of sum 1."""

GAUSS: Final[Array] = np.stack(np.meshgrid(LINE_POINTS, LINE_POINTS), axis=-1).reshape(-1, 2)
"""(9, 2) points, x first."""

WEIGHTS: Final[Array] = np.outer(LINE_WEIGHTS, LINE_WEIGHTS).ravel()
"""(9,) of sum 1."""


def _line_values(t: Array) -> Array:
    return np.stack([(1.0 - t) * (1.0 - 2.0 * t), 4.0 * t * (1.0 - t), t * (2.0 * t - 1.0)], axis=-1)


def _line_slopes(t: Array) -> Array:
    return np.stack([4.0 * t - 3.0, 4.0 - 8.0 * t, 4.0 * t - 1.0], axis=-1)


def values(points: Array) -> Array:
    """Return the nine shape functions at points (n, 2): (n, 9)."""
    x, y = _line_values(points[:, 0]), _line_values(points[:, 1])
    return (y[:, :, None] * x[:, None, :]).reshape(-1, 9)


def gradients(points: Array) -> tuple[Array, Array]:
    """Return the derivatives along x and y on the unit square at points (n, 2): (n, 9) each."""
    x, y = _line_values(points[:, 0]), _line_values(points[:, 1])
    dx, dy = _line_slopes(points[:, 0]), _line_slopes(points[:, 1])
    return (y[:, :, None] * dx[:, None, :]).reshape(-1, 9), (dy[:, :, None] * x[:, None, :]).reshape(-1, 9)
