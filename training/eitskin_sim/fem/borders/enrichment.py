"""The two functions of its own that an element has where a border passes, in the generators: what they add up to.

A function psi with a kink at the border and psi t, t along it, each less its biquadratic interpolant
(:mod:`eitskin_sim.fem.borders.cut_rule`). Slopes are taken at the middles of cells, of many elements at once; sums over
an element's points are products of matrices. Which psi it is, and what conducts where, is said by
:mod:`eitskin_sim.fem.borders.cut_blocks` for sharp borders, :mod:`eitskin_sim.fem.borders.graded_blocks` for others.
"""

from typing import Final

import numpy as np

from eitskin_sim.arrays import Array
from eitskin_sim.fem.borders.cut_rule import UNIT_NODES
from eitskin_sim.fem.q2 import gradients

POINTS: Final = 6
"""Points a side in a cut element, each with the cell around it."""


def _rule() -> tuple[Array, Array]:
    line = (np.arange(POINTS) + 0.5) / POINTS
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    slopes = np.stack(gradients(points), axis=0)  # (2, q, 9)
    return points, slopes


UNIT_POINTS: Final = _rule()[0]
"""(q, 2) middles of the cells of a unit element."""
SLOPES: Final = _rule()[1]
"""(2, q, 9) gradients of the shape functions there, along x and along y."""
_SLOPES_OF_HELD: Final = np.ascontiguousarray(SLOPES.reshape(-1, 9).T)
"""(9, 2 q) the slopes of what has some values at the nodes."""
_PLACES: Final = np.concatenate([UNIT_POINTS, UNIT_NODES]).T - 0.5
"""(2, q + 9) points and nodes of a unit element, from its middle."""


def _products() -> Array:
    x, y = SLOPES
    xy = np.einsum("qi,qj->qij", x, y)
    table = [np.einsum("qi,qj->qij", x, x), xy + np.swapaxes(xy, 1, 2), np.einsum("qi,qj->qij", y, y)]
    return np.stack(table, axis=1).reshape(len(x), -1) / len(x)


def _crossed() -> Array:
    (x, y), none = SLOPES, np.zeros_like(SLOPES[0])
    return np.concatenate([np.concatenate([x, y, none], axis=1), np.concatenate([none, x, y], axis=1)])


PRODUCTS: Final = _products()
"""(q, 3 * 81) integrands of xx, xy + yx and yy, with the weight of a cell."""
_CROSSED: Final = _crossed()
"""(2 q, 3 * 9) what a function's slopes, along x and then along y, make of xx, xy + yx and yy with shape functions."""


def enriched(sizes_mm: Array, normal: Array, psi_mm: Array, slope: Array) -> tuple[Array, Array, Array]:
    """Return psi and psi t of c elements: values (c, 2, 9) at the nodes, slopes, and those of their interpolants.

    Slopes are (c, 2 functions, xy, q), on the unit element, of lengths over the root of the element's area.

    Args:
        sizes_mm: (c, 2)
        normal: (c, q + 10, 2) of the border, outwards, at the points, the nodes and the middle.
        psi_mm: (c, q + 9) at the points and the nodes.
        slope: (c, q) of psi along the normal.
    """
    q, count = len(UNIT_POINTS), len(normal)
    scale = np.sqrt(sizes_mm[:, 0] * sizes_mm[:, 1])[:, None]
    stretch, along = sizes_mm / scale, np.empty((count, 2))
    np.multiply(normal[:, -1, 1], -stretch[:, 0], out=along[:, 0])
    np.multiply(normal[:, -1, 0], stretch[:, 1], out=along[:, 1])
    psi, t = psi_mm / scale, along @ _PLACES
    held, slopes = np.empty((count, 2, 9)), np.empty((count, 2, 2, q))
    held[:, 0] = psi[:, q:]
    np.multiply(psi[:, q:], t[:, q:], out=held[:, 1])
    straight = np.swapaxes(normal[:, :q], 1, 2) * (slope[:, None, :] * stretch[:, :, None])
    slopes[:, 0] = straight
    np.multiply(straight, t[:, None, :q], out=slopes[:, 1])
    slopes[:, 1] += psi[:, None, :q] * along[:, :, None]
    return held, slopes, (held.reshape(-1, 9) @ _SLOPES_OF_HELD).reshape(-1, 2, 2, q)


def crossed_slopes(slopes: Array) -> Array:
    """Return the (c, 3, 9, 2) products xx, xy + yx and yy of the shape functions' slopes and others.

    Args:
        slopes: (c, 2 functions, xy, q)
    """
    found = slopes.reshape(-1, len(_CROSSED)) @ _CROSSED
    return np.ascontiguousarray(found.reshape(-1, 2, 3, 9).transpose(0, 2, 3, 1))


def products(slopes: Array, weighted: Array) -> Array:
    """Return the (c, 4, 4) products of (c, 2 functions, xy, q) slopes, each function along x and along y."""
    count, q = len(slopes), slopes.shape[-1]
    return np.asarray(slopes.reshape(count, 4, q) @ np.swapaxes(weighted.reshape(count, 4, q), 1, 2))


def components(products: Array) -> Array:
    """Return the (c, 3, 2, 2) components xx, xy + yx and yy of (c, 4, 4) products."""
    mixed = products[:, ::2, 1::2]
    found = np.empty((len(products), 3, 2, 2))
    found[:, 0], found[:, 2] = products[:, ::2, ::2], products[:, 1::2, 1::2]
    np.add(mixed, np.swapaxes(mixed, 1, 2), out=found[:, 1])
    return found


def eliminated(coupling: Array, corner: Array) -> Array:
    """Return C K^-1 C^T of (c, 9, 2) and (c, 2, 2)."""
    determinant = corner[:, 0, 0] * corner[:, 1, 1] - corner[:, 0, 1] ** 2
    inverse = np.empty_like(corner)
    inverse[:, 0, 0], inverse[:, 1, 1] = corner[:, 1, 1] / determinant, corner[:, 0, 0] / determinant
    inverse[:, 0, 1] = inverse[:, 1, 0] = -corner[:, 0, 1] / determinant
    return np.asarray(coupling @ inverse @ np.swapaxes(coupling, 1, 2))
