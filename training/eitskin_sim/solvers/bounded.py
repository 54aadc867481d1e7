"""The exact minimum of a convex quadratic within bounds, by active sets.

    x = argmin 1/2 x^T H x - b^T x,   0 <= x <= upper,   H positive definite

Every cell is free, at 0 or at the upper bound. Given these states one linear system gives the free values, and the
slope shows which cells should leave their bound. First all cells that contradict their state change it at once: some
fourteen rounds settle most tactile images of 1350 cells, of which about 150 stay free. All at once can go in circles
(it does in one image of five); then one cell at a time is released, and the others stop where they meet a bound, as in
Lawson and Hanson's non-negative least squares, which lowers the quadratic with every step and so must end. Three
hundred projected gradient steps, for comparison, are still 1e-4 above the minimum, and a hundredth of CC off.
"""

from typing import Final

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from eitskin_sim.arrays import Array, Mask

BLOCK_ROUNDS: Final = 25
"""Rounds in which all cells change at once, before one at a time."""

TOLERANCE: Final = 1e-10
"""A slope or a value this far on the wrong side, relative to the largest of b, is no contradiction."""


def bounded_minimum(hessian: Array, linear: Array, upper: float = np.inf) -> Array:
    """Return the (n,) minimiser of 1/2 x^T H x - b^T x within 0 <= x <= upper.

    Args:
        hessian: (n, n) H, symmetric and positive definite.
        linear: (n,) b.
        upper: Largest value of a cell.

    Raises:
        ValueError: H is not positive definite, or the upper bound not positive.
    """
    if not upper > 0.0:
        raise ValueError(f"upper bound {upper} must be above 0")
    diagonal = np.diag(hessian)
    if not diagonal.min() > 0.0:
        raise ValueError(f"the quadratic is not positive definite: its diagonal falls to {diagonal.min():.3g}")
    scale = 1.0 / np.sqrt(diagonal)  # unit diagonal: the variances of cells differ by many orders
    h, b, top = hessian * scale[:, None] * scale, scale * linear, upper / scale
    slack = TOLERANCE * max(float(np.abs(b).max(initial=0.0)), 1e-300)
    low, high = b <= 0.0, np.zeros(len(b), dtype=np.bool_)
    for _ in range(BLOCK_ROUNDS):
        image, slope = _given(h, b, low, high, top)
        free = ~(low | high)
        below, above = free & (image < -slack), free & (image > top + slack)
        released = (low & (slope < -slack)) | (high & (slope > slack))
        if not (below | above | released).any():
            break
        low, high = (low & ~released) | below, (high & ~released) | above
    else:
        image = _one_at_a_time(h, b, np.clip(image, 0.0, top), top, slack)
    return np.asarray(np.where(image >= top, upper, np.maximum(image, 0.0) * scale))


def inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric positive definite matrix.

    Raises:
        ValueError: It is not positive definite.
    """
    factor, failed = lapack.dpotrf(matrix, lower=1, clean=1)
    if failed:
        raise ValueError(f"the matrix is not positive definite at row {failed}")
    half, _ = lapack.dpotri(factor, lower=1, overwrite_c=1)
    whole = half + half.T
    whole[np.diag_indices_from(whole)] *= 0.5
    return np.asarray(whole)


def _one_at_a_time(h: Array, b: Array, image: Array, top: Array, slack: float) -> Array:
    """The minimiser, from any image within the bounds."""
    low, high = image <= 0.0, image >= top
    while True:
        wanted, slope = _given(h, b, low, high, top)
        free = ~(low | high)
        beyond = np.flatnonzero(free & ((wanted < -slack) | (wanted > top + slack)))
        if len(beyond):
            bound = np.where(wanted[beyond] < 0.0, 0.0, top[beyond])
            shares = (bound - image[beyond]) / (wanted[beyond] - image[beyond])
            first = int(np.argmin(shares))
            image = image + max(float(shares[first]), 0.0) * (wanted - image)
            image[beyond[first]] = bound[first]
            (low if bound[first] == 0.0 else high)[beyond[first]] = True
            continue
        image = wanted
        pull = np.where(low, -slope, np.where(high, slope, 0.0))
        most = int(np.argmax(pull))
        if pull[most] <= slack:
            return image
        low[most] = high[most] = False


def _given(h: Array, b: Array, low: Mask, high: Mask, top: Array) -> tuple[Array, Array]:
    """The image whose bound cells stay where they are, and its slope, which is 0 at the free ones."""
    free = np.flatnonzero(~(low | high))
    image = np.where(high, top, 0.0) if high.any() else np.zeros(len(b))
    if len(free):
        right = b[free] - h[free] @ image if high.any() else b[free]
        image[free] = linalg.solve(h[np.ix_(free, free)], right, assume_a="pos", check_finite=False)
    filled = np.flatnonzero(image)
    slope = np.asarray(image[filled] @ h[filled] - b)
    slope[free] = 0.0
    return image, slope
