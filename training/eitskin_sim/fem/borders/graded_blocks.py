"""Elements that the graded borders of touches reach, in the generators: conductivity point by point, and a kink.

Beside :mod:`eitskin_sim.fem.borders.cut_blocks`, which has sharp borders and says what E is: an element gets the two
functions psi and psi t less their biquadratic interpolants, psi the kink of a graded border
(:mod:`eitskin_sim.fem.borders.graded`), of the touch whose outline is nearest, and S = S_1 + E_sigma - E_1. Logarithms
of several touches add up. A sharp touch in such an element counts as one with a border of a cell, since there its kink
cannot be told apart from the other's.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.borders.cut_rule import MIN_ENERGY_SHARE
from eitskin_sim.fem.borders.enrichment import (
    POINTS,
    PRODUCTS,
    UNIT_POINTS,
    components,
    crossed_slopes,
    eliminated,
    enriched,
    products,
)
from eitskin_sim.fem.borders.graded import kink, plateau

MIN_BORDER: Final = 1.0 / POINTS
"""The least border beside a graded one, in element sides."""


@dataclass(frozen=True, slots=True)
class GradedIntegrals:
    """Of g elements, by tensor component where there are 3.

    Args:
        added: (g, 3, 9, 9) integral of sigma - 1, biquadratic functions among themselves.
        coupling: (2, g, 3, 9, 2) of them with the kinks, at conductivity 1 and sigma.
        corner: (2, g, 3, 2, 2) of the kinks among themselves.
        centroid: (g, 2) middle of what the touch adds, from the element's middle, in its sides.
        sigma: (g,) S/m, the mean.
    """

    added: Array
    coupling: Array
    corner: Array
    centroid: Array
    sigma: Array

    def __len__(self) -> int:
        """Return how many elements there are."""
        return len(self.sigma)


def integrate_graded(
    group: Index, sizes_mm: Array, distance: Array, normal: Array, log_contrast: Array, border_mm: Array
) -> GradedIntegrals:
    """Return the integrals of elements, from their pairs with pieces.

    Args:
        group: (n,) which element each pair belongs to, ascending, from 0.
        sizes_mm: (g, 2)
        distance: (n, q + 10) mm from the piece's outline at the points, the nodes and the middle, negative inside.
        normal: (n, q + 10, 2) outwards.
        log_contrast: (n,) of the piece.
        border_mm: (n,) of the piece, above 0.
    """
    q, first = len(UNIT_POINTS), np.flatnonzero(np.append(True, group[1:] != group[:-1]))
    share = plateau(distance[:, :q], border_mm[:, None])
    sigma = np.exp(np.add.reduceat(log_contrast[:, None] * share, first, axis=0))
    order = np.lexsort((np.abs(distance[:, -1]), group))
    main = order[first]  # of every group the pair whose outline is nearest
    psi_mm, slope = kink(distance[main, :-1], log_contrast[main, None], border_mm[main, None])
    _, own, interpolant = enriched(sizes_mm, normal[main], psi_mm, slope[:, :q])
    bent = own - interpolant
    weighted = [bent / q, bent * (sigma / q)[:, None, None, :]]
    added = sigma - 1.0
    size = np.maximum(np.abs(added).sum(axis=1), 1e-30)
    return GradedIntegrals(
        added=(added @ PRODUCTS).reshape(-1, 3, 9, 9),
        coupling=np.array([crossed_slopes(mean) for mean in weighted]),
        corner=np.array([components(products(bent, mean)) for mean in weighted]),
        centroid=np.abs(added) @ (UNIT_POINTS - 0.5) / size[:, None],
        sigma=sigma.mean(axis=1),
    )


def graded_blocks(graded: GradedIntegrals, element: Index, tensor: Array, stiffness: Array) -> Array:
    """Return the (g, 9, 9) blocks of elements at one deformation; arguments as of ``cut_blocks``."""
    there = tensor[element]
    own = there[:, :, 0] + (there[:, :, 1:] @ graded.centroid[:, :, None])[:, :, 0]
    found = stiffness[element] + (own[:, None, :] @ graded.added.reshape(-1, 3, 81)).reshape(-1, 9, 9)
    floor = MIN_ENERGY_SHARE * (own[:, 0] + own[:, 2])[:, None]
    for sign, coupling, corner in zip((1.0, -1.0), graded.coupling, graded.corner, strict=True):
        held = (own[:, None, :] @ corner.reshape(-1, 3, 4)).reshape(-1, 2, 2)
        held[:, [0, 1], [0, 1]] += floor
        found += sign * eliminated((own[:, None, :] @ coupling.reshape(-1, 3, 18)).reshape(-1, 9, 2), held)
    return np.asarray(found)
