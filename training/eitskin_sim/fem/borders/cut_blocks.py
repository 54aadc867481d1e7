"""Elements that a touch's border cuts: biquadratic plus a kink, so that a touch keeps its size on any mesh.

Across the border of a touch the potential has a kink, which no polynomial has: an element with the mean conductivity
makes a touch of 10 mm look 2.5 mm too large. A cut element is therefore given two more functions of its own,

    d+(x)  and  d+(x) t(x),   each minus its biquadratic interpolant,   d+ = max(signed distance, 0), t along the border

whose strengths minimise its energy E. They vanish at the element's nodes; between them neighbours may differ a little,
as in any immersed finite element, so what counts is only what the touch changes:

    S = S_1 + E_sigma - E_1,      E_sigma = A_sigma - C_sigma K_sigma^-1 C_sigma^T

with A the biquadratic functions among themselves, K the enrichment functions and C between them. E grows with the
conductivity and E_sigma is at most sigma_max E_1, so S_1 <= S <= sigma_max S_1 as quadratic forms: no touch can do what
no conductor does. The conductance tensor is taken at the middle of the touched part; its three components c multiply
integrals that know only the touch, so a touch is integrated once for all deformations. The slope of a kink is its mean
over each cell:

    D_c = integral (sigma - 1) grad phi_i grad phi_j = A_sigma - A_1
    C_sigma = C_1 - D held,   K_sigma = K_1 + held^T D held      held: the enrichment's values at the nodes
"""

from dataclasses import dataclass

import numpy as np

from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.borders.cut_rule import MIN_ENERGY_SHARE
from eitskin_sim.fem.borders.enrichment import (
    PRODUCTS,
    UNIT_POINTS,
    components,
    crossed_slopes,
    eliminated,
    enriched,
    products,
)


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
    held, beyond, interpolant = enriched(sizes_mm, normal, np.maximum(distance[:, : q + 9], 0.0), np.ones_like(share))
    outer = ((1.0 - share) / q)[:, None, None, :]
    inner, outside = (share / q)[:, None, None, :], beyond - interpolant
    mean = beyond * outer - interpolant / q  # a cell's mean slope of a kink, with its weight
    return Integrals(
        added=(((inside - 1.0) * share) @ PRODUCTS).reshape(-1, 3, 9, 9),
        held=np.ascontiguousarray(np.swapaxes(held, 1, 2)),
        coupling=crossed_slopes(mean),
        corner=components(products(interpolant, interpolant * inner) + products(outside, outside * outer)),
        centroid=share @ (UNIT_POINTS - 0.5) / np.maximum(share.sum(axis=1), 1e-30)[:, None],
    )


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
    corner[:, [0, 1], [0, 1]] += MIN_ENERGY_SHARE * (own[:, 0] + own[:, 2])[:, None]
    moved = added @ cuts.held
    touched = corner + np.swapaxes(cuts.held, 1, 2) @ moved
    change = added - eliminated(coupling - moved, touched) + eliminated(coupling, corner)
    return np.asarray(stiffness[element] + change)
