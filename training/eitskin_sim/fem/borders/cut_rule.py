"""The share of elements and cells inside the border of a touch."""

from typing import Final

import numpy as np

from eitskin_sim.arrays import Array

SHARE_TOLERANCE: Final = 1e-9
"""A share of an element below this is none, and one this near to 1 is all: a border on a line of the mesh."""

MIN_ENERGY_SHARE: Final = 1e-8
"""An enrichment function whose energy is below this share of the element's is held back: dividing by it would divide by
rounding."""

UNIT_NODES: Final[Array] = np.stack(np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.5, 1.0]), axis=-1).reshape(-1, 2)
"""(9, 2) nodes of a unit element, along x first."""


def half_plane_share(distance: Array, normal: Array, sizes: Array) -> Array:
    """Return the share (...,) of rectangles on the inner side of a straight border.

    Args:
        distance: (...,) signed distance of the middle from the border, negative inside.
        normal: (..., 2) outward unit normal.
        sizes: (..., 2) width and height of each rectangle.
    """
    across, up = np.abs(normal[..., 0]) * sizes[..., 0], np.abs(normal[..., 1]) * sizes[..., 1]
    wide, narrow = np.maximum(across, up), np.minimum(across, up)
    # Along the normal the rectangle's section is a trapezium: a plateau of wide - narrow between two ramps of narrow.
    both = wide + narrow
    inside = np.minimum(np.maximum(both / 2 - distance, 0.0), both)
    ramp = np.where(narrow > 1e-12 * wide, narrow, 1.0)
    first = np.minimum(inside, narrow) ** 2 / (2.0 * ramp)
    plateau = np.minimum(np.maximum(inside - narrow, 0.0), wide - narrow)
    last = np.minimum(np.maximum(inside - wide, 0.0), narrow)
    return np.asarray((first + plateau + last * (1.0 - last / (2.0 * ramp))) / wide)


def union(one: Array, other: Array, facing: Array) -> Array:
    """Return the share that two shapes cover: borders that face each other abut, those that face one way overlap.

    Args:
        one: (...,) share of each cell inside one shape.
        other: (...,) inside the other.
        facing: (...,) product of the outward normals of their borders there.
    """
    apart = np.minimum(one + other, 1.0)
    across = one + other - one * other
    return np.where(facing < -0.5, apart, np.where(facing > 0.5, np.maximum(one, other), across))
