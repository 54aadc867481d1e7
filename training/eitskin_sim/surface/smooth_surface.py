"""A smooth surface through noisy points whose place on the sheet is known, redrawn evenly by arc length.

The points are averaged in cells of the flat sheet and a thin-plate spline, the radial basis function r^2 log r, is
fitted to the averages: each of x, y, z is the function that least violates ::

    sum_i n_i (f(p_i) - mean_i)^2  +  density * h^4 * integral |second derivatives of f|^2

which passes wavelengths longer than 2 pi h and bridges holes as a bent plate would. A mean over a cell of side c lies
inside a curved surface by c^2 / 24 of each second derivative, 0.02 mm at a radius of 50 mm: the spread of each cell's
points is known, so the fit is repeated with that offset taken away, which costs only a back substitution.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Final

import numpy as np
from scipy import linalg
from scipy.interpolate import make_interp_spline

from eitskin_sim.arrays import Array

CELL_MM: Final = 6.0
"""Side of the cells whose points are averaged: 425 of them, and a fit of a fifth of the cost of 4.5 mm cells'."""

SMOOTHING_MM: Final = 2.5
"""h: a bump of sigma 12 mm loses 0.2 % of its height to it."""

NODE_MM: Final = 5.0
"""About the distance of the nodes at which the fitted spline is evaluated; cubic splines go on from there."""

ROUNDS: Final = 3
"""Times that rows and columns are redrawn evenly."""

CHORDS_PER_STEP: Final = 8
"""Arc length is summed over chords this many times shorter than a step between nodes."""


def nodes_of(size_mm: tuple[float, float]) -> tuple[int, int]:
    """Return how many nodes a flat sheet has along x and along y."""
    return round(size_mm[0] / NODE_MM) + 1, round(size_mm[1] / NODE_MM) + 1


def fit_surface(places_mm: Array, points_mm: Array, size_mm: tuple[float, float], nodes: tuple[int, int]) -> Array:
    """Return (3, ny, nx) smooth positions on nodes that span the sheet from side to side.

    Args:
        places_mm: (2, n) where the points lie on the flat sheet.
        points_mm: (3, n) where they lie in space.
        size_mm: Length and width of the flat sheet.
        nodes: How many along x and along y.
    """
    centre, mean, count, spread = _average(places_mm, points_mm, size_mm)
    lines = (np.linspace(0.0, s, n) for s, n in zip(size_mm, nodes, strict=True))
    at = np.stack(np.meshgrid(*lines), 0).reshape(2, -1)
    stiffness = count.sum() / (size_mm[0] * size_mm[1]) * SMOOTHING_MM**4
    solve = _plate_solver(centre, stiffness / count)
    kernel = np.concatenate([_kernel(at, centre), np.ones((at.shape[1], 1)), at.T], axis=1)
    fitted = (kernel @ solve(mean)).T.reshape(3, nodes[1], nodes[0])
    data = mean - _inside(fitted, size_mm, centre, spread)
    # A plate ends straight, a bent sheet does not: fitting what the first fit left over takes 3/4 of that error away.
    coefficients = solve(data)
    left_over = (stiffness / count)[:, None] * coefficients[:-3]
    return np.asarray((kernel @ (coefficients + solve(left_over))).T.reshape(3, nodes[1], nodes[0]))


def by_arc_length(surface: Array, shape: tuple[int, int]) -> Array:
    """Return (3, rows, columns) points at the centres of equal parts, by arc length, of a surface's rows and columns.

    Rows and columns are redrawn in turn until both are even; on a sheet that is stretched evenly that is where the
    material is. Uneven stretch leaves no trace in a surface without marks, and none is invented.

    Args:
        surface: (3, ny, nx) positions from side to side.
        shape: Rows and columns of the result.
    """
    even = surface
    for _ in range(ROUNDS):
        even = _even(_even(even, axis=2), axis=1)
    rows, columns = ((np.arange(n) + 0.5) / n for n in shape)
    return _sample(_sample(even, columns, axis=2), rows, axis=1)


def side_lengths_mm(surface: Array) -> tuple[float, float]:
    """Return the mean arc length of a surface's rows and of its columns."""
    along_rows, along_columns = (_fine(np.moveaxis(surface, axis, -1))[1][:, -1].mean() for axis in (2, 1))
    return float(along_rows), float(along_columns)


def _average(places: Array, points: Array, size_mm: tuple[float, float]) -> tuple[Array, Array, Array, Array]:
    """(2, m) mean places, (m, 3) mean points, (m,) counts and (3, m) second moments uu, vv, uv of the places."""
    shape = [int(np.ceil(s / CELL_MM)) for s in size_mm]
    cell = [np.clip((p * (n / s)).astype(np.intp), 0, n - 1) for p, n, s in zip(places, shape, size_mm, strict=True)]
    key = cell[0] * shape[1] + cell[1]
    total = np.bincount(key, minlength=shape[0] * shape[1])
    used = total > 0
    count = total[used].astype(np.float64)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(key, weights=values, minlength=len(total))[used] / count)

    u, v = places
    centre = np.stack([mean(u), mean(v)])
    spread = np.stack([mean(u * u) - centre[0] ** 2, mean(v * v) - centre[1] ** 2, mean(u * v) - centre[0] * centre[1]])
    return centre, np.stack([mean(axis) for axis in points], axis=-1), count, spread


def _kernel(first: Array, second: Array) -> Array:
    """(a, b) r^2 log r / (8 pi), the fundamental solution of the plate equation."""
    squared = np.sum(first**2, axis=0)[:, None] + np.sum(second**2, axis=0) - 2.0 * first.T @ second
    np.maximum(squared, 1e-12, out=squared)
    squared *= np.log(squared)
    squared *= 1.0 / (16.0 * np.pi)
    return np.asarray(squared)


def _plate_solver(centre: Array, slack: Array) -> Callable[[Array], Array]:
    """Function from (m, k) values to the (m + 3, k) coefficients of the smoothing thin-plate spline."""
    matrix = _kernel(centre, centre)
    matrix[np.diag_indices(len(slack))] += slack
    planes = np.concatenate([np.ones((len(slack), 1)), centre.T], axis=1)
    unit, triangle = np.linalg.qr(planes)
    # Coefficients are orthogonal to the planes, and there the kernel is positive definite: project, and take a Cholesky
    # factorisation, half the cost of an LU of the bordered matrix.
    on_planes = matrix @ unit
    half = on_planes - 0.5 * unit @ (unit.T @ on_planes + float(slack.mean()) * np.eye(3))
    matrix -= half @ unit.T
    matrix -= unit @ half.T
    factor = linalg.cho_factor(matrix, lower=True, overwrite_a=True, check_finite=False)

    def solve(values: Array) -> Array:
        bending = linalg.cho_solve(factor, values - unit @ (unit.T @ values), check_finite=False)
        plane = np.linalg.solve(triangle, unit.T @ values - on_planes.T @ bending)
        return np.concatenate([bending, plane])

    return solve


def _inside(fitted: Array, size_mm: tuple[float, float], centre: Array, spread: Array) -> Array:
    """(m, 3) how far the mean over each cell lies from the surface at the cell's mean place."""
    nodes = fitted.shape[:0:-1]
    step = [s / (n - 1) for s, n in zip(size_mm, nodes, strict=True)]
    second = np.zeros((3, *fitted.shape))
    second[0, :, :, 1:-1] = (fitted[:, :, 2:] - 2.0 * fitted[:, :, 1:-1] + fitted[:, :, :-2]) / step[0] ** 2
    second[1, :, 1:-1, :] = (fitted[:, 2:, :] - 2.0 * fitted[:, 1:-1, :] + fitted[:, :-2, :]) / step[1] ** 2
    second[0, :, :, [0, -1]] = second[0, :, :, [1, -2]]
    second[1, :, [0, -1], :] = second[1, :, [1, -2], :]
    second[2] = np.gradient(np.gradient(fitted, step[0], axis=2), step[1], axis=1)
    column = np.clip(np.round(centre[0] / step[0]).astype(np.intp), 0, nodes[0] - 1)
    row = np.clip(np.round(centre[1] / step[1]).astype(np.intp), 0, nodes[1] - 1)
    here = second[:, :, row, column]
    return np.asarray((0.5 * here[0] * spread[0] + 0.5 * here[1] * spread[1] + here[2] * spread[2]).T)


def _fine(curves: Array) -> tuple[Array, Array]:
    """(3, k, m) points on cubic splines through (3, k, n) curves, and (k, m) the arc length up to each."""
    fine = curves @ _refinement(curves.shape[-1]).T
    steps = np.sqrt(np.sum(np.diff(fine, axis=-1) ** 2, axis=0))
    return fine, np.concatenate([np.zeros((len(steps), 1)), np.cumsum(steps, axis=-1)], axis=-1)


@lru_cache(maxsize=8)
def _refinement(n: int) -> Array:
    """(m, n) from values at n nodes to the cubic spline's values, ``CHORDS_PER_STEP`` to a step."""
    spline = make_interp_spline(np.arange(n), np.eye(n))
    return np.asarray(spline(np.linspace(0.0, n - 1.0, (n - 1) * CHORDS_PER_STEP + 1)))


def _even(surface: Array, axis: int) -> Array:
    """The same surface with every curve along an axis redrawn at equal steps of its arc length."""
    curves = np.moveaxis(surface, axis, -1)
    n = curves.shape[-1]
    fine, arc = _fine(curves)
    m, rows = arc.shape[1], np.arange(len(arc))[:, None]
    share = arc / arc[:, -1:]
    wanted = np.broadcast_to(np.linspace(0.0, 1.0, n), (len(arc), n))
    # One search for all curves: curve r occupies the interval [2 r, 2 r + 1].
    after = (
        np.searchsorted((share + 2.0 * rows).ravel(), (wanted + 2.0 * rows).ravel()).reshape(wanted.shape) - m * rows
    )
    low = np.clip(after - 1, 1, m - 3)
    step = (wanted - share[rows, low]) / (share[rows, low + 1] - share[rows, low])
    weights = (
        -step * (step - 1.0) * (step - 2.0) / 6.0,
        (step + 1.0) * (step - 1.0) * (step - 2.0) / 2.0,
        -(step + 1.0) * step * (step - 2.0) / 2.0,
        (step + 1.0) * step * (step - 1.0) / 6.0,
    )
    redrawn = sum(weight * fine[:, rows, low + shift] for shift, weight in zip((-1, 0, 1, 2), weights, strict=True))
    return np.moveaxis(np.asarray(redrawn), -1, axis)


def _sample(surface: Array, fraction: Array, axis: int) -> Array:
    n = surface.shape[axis]
    return np.asarray(make_interp_spline(np.linspace(0.0, 1.0, n), surface, axis=axis)(fraction))
