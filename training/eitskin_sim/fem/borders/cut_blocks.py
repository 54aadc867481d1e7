"""Elements that a touch's border cuts: their blocks, from integrals that do not depend on the deformation.

Across a border the potential has a kink. As in :mod:`eitskin_sim.fem.borders.cut_elements` (what the two share and
where they differ is in :mod:`eitskin_sim.fem.borders.cut_rule`), a cut element gets two functions of its own, d+ and
d+ t less their biquadratic interpolants (d+ the distance outside, t along the border), whose strengths minimise the
element's energy E. They differ a little between neighbours, so what counts is only what the touch changes:

    S = S_1 + E_sigma - E_1,      E_sigma = A_sigma - C_sigma K_sigma^-1 C_sigma^T

with A the biquadratic functions among themselves, K the enrichment functions and C between them. E grows with the
conductivity and E_sigma is at most sigma_max E_1, so S_1 <= S <= sigma_max S_1 as quadratic forms: no touch can do what
no conductor does. The conductance tensor is taken at the middle of the touched part; its three components c multiply
integrals that know only the touch, so a touch is integrated once for all deformations:

    D_c = integral (sigma - 1) grad phi_i grad phi_j = A_sigma - A_1
    C_sigma = C_1 - D held,   K_sigma = K_1 + held^T D held      held: the enrichment's values at the nodes
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_sim.fem.borders.cut_rule import FLOOR, UNIT_NODES
from eitskin_sim.fem.mesh import Index
from eitskin_sim.fem.q2 import gradients
from eitskin_sim.scene.touch_table import Array

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
SLOPES_OF_HELD: Final = np.ascontiguousarray(SLOPES.reshape(-1, 9).T)
"""(9, 2 q) the slopes of what has some values at the nodes."""
PLACES: Final = np.concatenate([UNIT_POINTS, UNIT_NODES]).T - 0.5
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
CROSSED: Final = _crossed()
"""(2 q, 3 * 9) what a function's slopes, along x and then along y, make of xx, xy + yx and yy with shape functions."""


@dataclass(frozen=True, slots=True)
class Integrals:
    """Of c cut elements, by tensor component where there are 3.

    Args:
        added: (c, 3, 9, 9) D.
        held: (c, 9, 2) the enrichment functions at the nodes.
        coupling: (c, 3, 9, 2) C_1.
        corner: (c, 3, 2, 2) K_1.
        centroid: (c, 2) middle of the touched part, from the element's middle, in its sides.
    """

    added: Array
    held: Array
    coupling: Array
    corner: Array
    centroid: Array


def integrate(sizes_mm: Array, distance: Array, normal: Array, share: Array, inside: Array) -> Integrals:
    """Return the integrals of cut elements.

    Args:
        sizes_mm: (c, 2)
        distance: (c, q + 10) mm from the border at the points, the nodes and the middle, negative inside.
        normal: (c, q + 10, 2) outwards.
        share: (c, q) of each point's cell inside.
        inside: (c, q) S/m of the touch there.
    """
    q = len(UNIT_POINTS)
    scale = np.sqrt(sizes_mm.prod(axis=1))[:, None]
    middle, stretch = normal[:, -1], sizes_mm / scale  # from mm to the unit element, over the scale
    along = np.stack([-middle[:, 1], middle[:, 0]], axis=-1) * stretch
    plus = np.maximum(distance[:, : q + 9], 0.0) / scale
    t = along @ PLACES
    held = with_slope(plus[:, q:], t[:, q:])
    straight = np.swapaxes(normal[:, :q], 1, 2) * stretch[:, :, None]
    beyond = kinked(straight, along, plus[:, :q], t[:, :q])
    interpolant = slopes_of(held)
    outer = ((1.0 - share) / q)[:, None, None, :]
    inner, outside = (share / q)[:, None, None, :], beyond - interpolant
    mean = beyond * outer - interpolant / q  # a cell's mean slope of a kink, with its weight
    return Integrals(
        added=(((inside - 1.0) * share) @ PRODUCTS).reshape(-1, 3, 9, 9),
        held=np.ascontiguousarray(np.swapaxes(held, 1, 2)),
        coupling=crossed_slopes(mean),
        corner=products_of(products(interpolant, interpolant * inner) + products(outside, outside * outer)),
        centroid=share @ (UNIT_POINTS - 0.5) / np.maximum(share.sum(axis=1), 1e-30)[:, None],
    )


def with_slope(values: Array, t: Array) -> Array:
    """Return (c, 2, n) values of enrichment functions: some (c, n), and those times t along the border."""
    return np.stack([values, values * t], axis=1)


def kinked(straight: Array, along: Array, values: Array, t: Array) -> Array:
    """Return the (c, 2 functions, xy, q) slopes of enrichment functions.

    Args:
        straight: (c, xy, q) of the first, across the border.
        along: (c, xy) of t.
        values: (c, q) of the first.
        t: (c, q) along the border.
    """
    return np.stack([straight, straight * t[:, None, :] + values[:, None, :] * along[:, :, None]], axis=1)


def slopes_of(held: Array) -> Array:
    """Return the (c, 2 functions, xy, q) slopes of biquadratic functions of (c, 2, 9) values at the nodes."""
    return np.asarray((held.reshape(-1, 9) @ SLOPES_OF_HELD).reshape(-1, 2, 2, len(UNIT_POINTS)))


def crossed_slopes(slopes: Array) -> Array:
    """Return the (c, 3, 9, 2) products xx, xy + yx and yy of the shape functions' slopes and others.

    Args:
        slopes: (c, 2 functions, xy, q)
    """
    found = slopes.reshape(-1, len(CROSSED)) @ CROSSED
    return np.ascontiguousarray(found.reshape(-1, 2, 3, 9).transpose(0, 2, 3, 1))


def products(slopes: Array, weighted: Array) -> Array:
    """Return the (c, 4, 4) products of (c, 2 functions, xy, q) slopes, each function along x and along y."""
    count, q = len(slopes), slopes.shape[-1]
    return np.asarray(slopes.reshape(count, 4, q) @ np.swapaxes(weighted.reshape(count, 4, q), 1, 2))


def products_of(products: Array) -> Array:
    """Return the (c, 3, 2, 2) components xx, xy + yx and yy of (c, 4, 4) products."""
    mixed = products[:, ::2, 1::2]
    return np.stack([products[:, ::2, ::2], mixed + np.swapaxes(mixed, 1, 2), products[:, 1::2, 1::2]], axis=1)


def cut_blocks(cuts: Integrals, element: Index, tensor: Array, stiffness: Array) -> Array:
    """Return the (c, 9, 9) blocks of cut elements at one deformation.

    Args:
        cuts: What touches make of them.
        element: (c,) which elements.
        tensor: (n_elements, 3, 3) conductance: its components at the middle, their change along x and along y.
        stiffness: (n_elements, 9, 9) S of the untouched elements at 1 S/m.
    """
    there = tensor[element]
    own = there[:, :, 0] + (there[:, :, 1:] @ cuts.centroid[:, :, None])[:, :, 0]
    added = (own[:, None, :] @ cuts.added.reshape(-1, 3, 81)).reshape(-1, 9, 9)
    coupling = (own[:, None, :] @ cuts.coupling.reshape(-1, 3, 18)).reshape(-1, 9, 2)
    corner = (own[:, None, :] @ cuts.corner.reshape(-1, 3, 4)).reshape(-1, 2, 2)
    corner[:, [0, 1], [0, 1]] += FLOOR * (own[:, 0] + own[:, 2])[:, None]
    moved = added @ cuts.held
    touched = corner + np.swapaxes(cuts.held, 1, 2) @ moved
    change = added - eliminated(coupling - moved, touched) + eliminated(coupling, corner)
    return np.asarray(stiffness[element] + change)


def eliminated(coupling: Array, corner: Array) -> Array:
    """Return C K^-1 C^T of (c, 9, 2) and (c, 2, 2)."""
    determinant = corner[:, 0, 0] * corner[:, 1, 1] - corner[:, 0, 1] ** 2
    inverse = np.empty_like(corner)
    inverse[:, 0, 0], inverse[:, 1, 1] = corner[:, 1, 1] / determinant, corner[:, 0, 0] / determinant
    inverse[:, 0, 1] = inverse[:, 1, 0] = -corner[:, 0, 1] / determinant
    return np.asarray(coupling @ inverse @ np.swapaxes(coupling, 1, 2))
