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
    slopes = np.stack(gradients(points), axis=1)  # (q, 2, 9)
    return points, slopes


UNIT_POINTS: Final = _rule()[0]
"""(q, 2) middles of the cells of a unit element."""
SLOPES: Final = _rule()[1]
"""(q, 2, 9) gradients of the shape functions there."""


def _products() -> Array:
    x, y = SLOPES[:, 0], SLOPES[:, 1]
    xy = np.einsum("qi,qj->qij", x, y)
    table = [np.einsum("qi,qj->qij", x, x), xy + np.swapaxes(xy, 1, 2), np.einsum("qi,qj->qij", y, y)]
    return np.stack(table, axis=1).reshape(len(x), -1) / len(x)


PRODUCTS: Final = _products()
"""(q, 3 * 81) integrands of xx, xy + yx and yy, with the weight of a cell."""


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
    q, count = len(UNIT_POINTS), len(sizes_mm)
    scale = np.sqrt(sizes_mm.prod(axis=1))[:, None]
    middle = normal[:, -1]
    along = np.stack([-middle[:, 1], middle[:, 0]], axis=-1)
    plus = np.maximum(distance, 0.0) / scale
    t = ((np.concatenate([UNIT_POINTS, UNIT_NODES]) - 0.5) * sizes_mm[:, None, :] @ along[:, :, None])[..., 0] / scale
    nodes = slice(q, q + 9)
    held = np.stack([plus[:, nodes], plus[:, nodes] * t[:, nodes]], axis=-1)

    stretch = (sizes_mm / scale)[:, None, :]  # from mm to the unit element, over the scale
    straight = normal[:, :q] * stretch
    sloped = straight * t[:, :q, None] + plus[:, :q, None] * (along[:, None, :] * stretch)
    interpolant = (SLOPES.reshape(-1, 9) @ held).reshape(count, q, 2, 2)
    beyond = np.stack([straight, sloped], axis=-1)  # (c, q, xy, 2 functions)
    outer = (1.0 - share)[:, :, None, None] / q
    mean = beyond * outer - interpolant / q  # a cell's mean slope of a kink, with its weight
    inner, outside = interpolant * (share[:, :, None, None] / q), beyond - interpolant
    corner = products_of(interpolant, inner) + products_of(outside, outside * outer)
    return Integrals(
        added=(((inside - 1.0) * share) @ PRODUCTS).reshape(count, 3, 9, 9),
        held=held,
        coupling=crossed_slopes(mean),
        corner=corner,
        centroid=share @ (UNIT_POINTS - 0.5) / np.maximum(share.sum(axis=1), 1e-30)[:, None],
    )


def _x(slopes: Array) -> Array:
    """Return (c, 9, 2): the x slopes of the shape functions times those of enrichment functions, added up."""
    return np.asarray(SLOPES[:, 0].T @ slopes[:, :, 0])


def _y(slopes: Array) -> Array:
    return np.asarray(SLOPES[:, 1].T @ slopes[:, :, 1])


def crossed_slopes(slopes: Array) -> Array:
    """Return the (c, 3, 9, 2) products xx, xy + yx and yy of the shape functions' slopes and (c, q, 2, 2) others."""
    coupling = np.stack([_x(slopes), _y(slopes)], axis=1)
    crossed = SLOPES[:, 1].T @ slopes[:, :, 0] + SLOPES[:, 0].T @ slopes[:, :, 1]
    return np.insert(coupling, 1, crossed, axis=1)


def products_of(slopes: Array, weighted: Array) -> Array:
    """Return the (c, 3, 2, 2) products xx, xy + yx and yy of (c, q, 2, 2) slopes and weighted slopes."""
    x, y = np.swapaxes(slopes[:, :, 0], 1, 2), np.swapaxes(slopes[:, :, 1], 1, 2)
    mixed = x @ weighted[:, :, 1]
    return np.stack([x @ weighted[:, :, 0], mixed + np.swapaxes(mixed, 1, 2), y @ weighted[:, :, 1]], axis=1)


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
