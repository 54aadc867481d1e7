"""Elements that a touch's border cuts, for many touch sets at once: what does not depend on the deformation.

Across a border the potential has a kink. As in :mod:`eitskin_sim.cut`, a cut element gets two functions of its own,
d+ and d+ t less their biquadratic interpolants (d+ the distance outside, t along the border), which are eliminated.
With the conductance tensor taken at the element's middle, its three components c multiply integrals that know only
the touch:

    D_c = integral (sigma - 1) grad phi_i grad phi_j     what the touch adds to the element
    coupling = -D held                                   held: the kinks' values at the nodes; they are biquadratic
    inside corner_c = held^T (1 + D)_inside held + integral over the outside of (grad k - grad I)(grad k - grad I)

So a touch set is integrated once, and every deformation costs three multiplications and a 2 x 2 inverse a cut element.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.cut import half_plane_share
from eitskin_sim.free_touches import DISC, Array, FreeTouches, bounds
from eitskin_sim.mesh import Index, TensorMesh
from eitskin_sim.q2 import gradients

POINTS: Final = 6
"""Points a side in a cut element, each with the cell around it."""

WHOLE: Final = 1e-9
"""A share of an element below this is none, and one above 1 - WHOLE is all."""


def _rule() -> tuple[Array, Array, Array]:
    line = (np.arange(POINTS) + 0.5) / POINTS
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    nodes = np.stack(np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.5, 1.0]), axis=-1).reshape(-1, 2)
    slopes = np.stack(gradients(points), axis=1)  # (q, 2, 9)
    return points, nodes, slopes


UNIT_POINTS: Final = _rule()[0]
"""(q, 2) middles of the cells of a unit element."""
UNIT_NODES: Final = _rule()[1]
"""(9, 2)"""
SLOPES: Final = _rule()[2]
"""(q, 2, 9) gradients of the shape functions there."""


def _products() -> Array:
    x, y = SLOPES[:, 0], SLOPES[:, 1]
    xy = np.einsum("qi,qj->qij", x, y)
    table = [np.einsum("qi,qj->qij", x, x), xy + np.swapaxes(xy, 1, 2), np.einsum("qi,qj->qij", y, y)]
    return np.stack(table, axis=1).reshape(len(x), -1) / len(x)


PRODUCTS: Final = _products()
"""(q, 3 * 81) integrands of xx, xy + yx and yy, with the weight of a cell."""


@dataclass(frozen=True, slots=True)
class Cuts:
    """Touched elements of several sets, e in all, of which the first c are cut.

    Args:
        of_set: (e,) which set, counted from the first of these.
        element: (e,) which element.
        sigma: (e,) S/m, the mean inside.
        share: (e,) of the element's area inside; 1 after the first c.
        added: (c, 3, 9, 9) D by tensor component.
        held: (c, 9, 2) the kinks at the nodes.
        corner: (c, 3, 2, 2) by tensor component.
    """

    of_set: Index
    element: Index
    sigma: Array
    share: Array
    added: Array
    held: Array
    corner: Array

    @property
    def n_cut(self) -> int:
        """How many are cut."""
        return len(self.added)


def find_cuts(touches: FreeTouches, sets: Index, mesh: TensorMesh) -> Cuts:
    """Return what some touch sets do to a mesh's elements.

    Args:
        touches: The table.
        sets: (s,) which of its sets.
        mesh: The fixed mesh.
    """
    counts = np.diff(touches.first)[sets]
    rows = np.concatenate([np.arange(touches.first[s], touches.first[s + 1]) for s in sets] or [np.zeros(0, np.intp)])
    pieces, owner = touches.pieces[rows.astype(np.intp)], np.repeat(np.arange(len(sets)), counts)
    piece, element = _near(pieces, mesh)
    middle, _ = _distance(pieces[piece], mesh.centres_mm[element][:, None, :])
    reach = np.hypot(*mesh.sizes_mm[element].T) / 2
    whole, crossed = middle[:, 0] <= -reach, np.abs(middle[:, 0]) < reach
    pair = _integrate(pieces, piece[crossed], element[crossed], mesh)
    inside = pair.mean > 1.0 - WHOLE
    full = np.concatenate([np.flatnonzero(whole), np.flatnonzero(crossed)[inside]])
    cut = np.flatnonzero((pair.mean > WHOLE) & ~inside)
    united = _unite(pair, cut, owner, mesh)
    covered = (owner[piece[full]], element[full], pieces[piece[full], 6])
    return Cuts(
        of_set=np.concatenate([united.of_set, covered[0]]),
        element=np.concatenate([united.element, covered[1]]),
        sigma=np.concatenate([united.sigma, covered[2]]),
        share=np.concatenate([united.share, np.ones(len(full))]),
        added=united.added,
        held=united.held,
        corner=united.corner,
    )


def _near(pieces: Array, mesh: TensorMesh) -> tuple[Index, Index]:
    """Return pairs of piece and element whose boxes meet."""
    boxes = np.array([bounds(piece) for piece in pieces]).reshape(-1, 4)
    ny, nx = mesh.shape
    first_x = np.clip(np.searchsorted(mesh.x_lines_mm, boxes[:, 0], side="right") - 1, 0, nx - 1)
    last_x = np.clip(np.searchsorted(mesh.x_lines_mm, boxes[:, 2], side="left"), 1, nx)
    first_y = np.clip(np.searchsorted(mesh.y_lines_mm, boxes[:, 1], side="right") - 1, 0, ny - 1)
    last_y = np.clip(np.searchsorted(mesh.y_lines_mm, boxes[:, 3], side="left"), 1, ny)
    wide, high = last_x - first_x, last_y - first_y
    piece = np.repeat(np.arange(len(pieces)), wide * high)
    count = np.arange(len(piece)) - np.repeat(np.cumsum(wide * high) - wide * high, wide * high)
    row, column = np.divmod(count, wide[piece])
    return piece, (first_y[piece] + row) * nx + first_x[piece] + column


def _distance(pieces: Array, points: Array) -> tuple[Array, Array]:
    """Return signed distances (n, q) and outward normals (n, q, 2) of points (n, q, 2) from (n, 7) pieces."""
    offset = points - pieces[:, None, 1:3]
    turn = np.deg2rad(pieces[:, 5])
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    local_x = cos * offset[..., 0] + sin * offset[..., 1]
    local_y = cos * offset[..., 1] - sin * offset[..., 0]
    beyond_x = np.abs(local_x) - pieces[:, None, 3] / 2
    beyond_y = np.abs(local_y) - pieces[:, None, 4] / 2
    out_x, out_y = np.maximum(beyond_x, 0.0), np.maximum(beyond_y, 0.0)
    length = np.hypot(out_x, out_y)
    distance = length + np.minimum(np.maximum(beyond_x, beyond_y), 0.0)
    outside = length > 0.0
    along_x = beyond_x >= beyond_y
    safe = np.where(outside, length, 1.0)
    normal_x = np.where(outside, out_x / safe, along_x) * np.where(local_x < 0.0, -1.0, 1.0)
    normal_y = np.where(outside, out_y / safe, ~along_x) * np.where(local_y < 0.0, -1.0, 1.0)
    normal = np.stack([cos * normal_x - sin * normal_y, sin * normal_x + cos * normal_y], axis=-1)
    round_ones = np.flatnonzero(pieces[:, 0] == DISC)
    if len(round_ones):
        radius = np.hypot(offset[round_ones, :, 0], offset[round_ones, :, 1])
        distance[round_ones] = radius - pieces[round_ones, None, 3] / 2
        normal[round_ones] = offset[round_ones] / np.maximum(radius, 1e-12)[..., None]
    return distance, normal


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Pieces and elements that they may cut."""

    piece: Index
    element: Index
    sigma: Array
    distance: Array
    """(n, q + 10) mm at the points, the nodes and the middle."""
    normal: Array
    share: Array
    """(n, q) of each point's cell inside."""
    mean: Array


def _integrate(pieces: Array, piece: Index, element: Index, mesh: TensorMesh) -> _Pairs:
    unit = np.concatenate([UNIT_POINTS, UNIT_NODES, [[0.5, 0.5]]])
    sizes = mesh.sizes_mm[element]
    where = mesh.corners_mm[element][:, None, :] + unit * sizes[:, None, :]
    distance, normal = _distance(pieces[piece], where)
    q = len(UNIT_POINTS)
    share = half_plane_share(distance[:, :q], normal[:, :q], sizes[:, None, :] / POINTS)
    return _Pairs(piece, element, pieces[piece, 6], distance, normal, share, share.mean(axis=1))


def _unite(pair: _Pairs, cut: Index, owner: Index, mesh: TensorMesh) -> Cuts:
    """Return cut elements, each once a set: pieces in one element make one inside."""
    key = owner[pair.piece[cut]] * mesh.n_elements + pair.element[cut]
    order = np.argsort(key, kind="stable")
    cut, key = cut[order], key[order]
    fresh = np.append(True, key[1:] != key[:-1]) if len(key) else np.zeros(0, dtype=np.bool_)
    group = np.cumsum(fresh) - 1
    first = cut[fresh]
    q = len(UNIT_POINTS)
    distance, normal, share = pair.distance[first], pair.normal[first], pair.share[first]
    inside = np.repeat(pair.sigma[first][:, None], q, axis=1)
    rank = np.arange(len(cut)) - np.flatnonzero(fresh)[group] if len(cut) else group
    for level in range(1, int(rank.max(initial=0)) + 1):
        own, row = cut[rank == level], group[rank == level]
        nearer = pair.distance[own] < distance[row]
        facing = np.einsum("kqa,kqa->kq", pair.normal[own][:, :q], normal[row][:, :q])
        inside[row] = np.where(nearer[:, :q], pair.sigma[own][:, None], inside[row])
        share[row] = _union(share[row], pair.share[own], facing)
        distance[row] = np.where(nearer, pair.distance[own], distance[row])
        normal[row] = np.where(nearer[..., None], pair.normal[own], normal[row])
    return _cuts(owner[pair.piece[first]], pair.element[first], mesh, distance, normal, share, inside)


def _union(one: Array, other: Array, facing: Array) -> Array:
    """Return the share of both: borders that face each other abut, those that face one way overlap."""
    apart = np.minimum(one + other, 1.0)
    return np.where(facing < -0.5, apart, np.where(facing > 0.5, np.maximum(one, other), one + other - one * other))


def _cuts(
    of_set: Index, element: Index, mesh: TensorMesh, distance: Array, normal: Array, share: Array, inside: Array
) -> Cuts:
    q, count = len(UNIT_POINTS), len(element)
    sizes = mesh.sizes_mm[element]
    scale = np.sqrt(sizes.prod(axis=1))[:, None]
    middle = normal[:, -1]
    along = np.stack([-middle[:, 1], middle[:, 0]], axis=-1)
    plus = np.maximum(distance, 0.0) / scale
    t = ((np.concatenate([UNIT_POINTS, UNIT_NODES]) - 0.5) * sizes[:, None, :] @ along[:, :, None])[..., 0] / scale
    nodes = slice(q, q + 9)
    held = np.stack([plus[:, nodes], plus[:, nodes] * t[:, nodes]], axis=-1)  # (c, 9, 2)

    added = ((inside - 1.0) * share) @ PRODUCTS
    stretch = (sizes / scale)[:, None, :]  # from mm to the unit element, over the scale
    unit_normal, unit_along = normal[:, :q] * stretch, along[:, None, :] * stretch
    straight = unit_normal
    sloped = unit_normal * t[:, :q, None] + plus[:, :q, None] * unit_along
    interpolant = (SLOPES.reshape(-1, 9) @ held).reshape(count, q, 2, 2)
    beyond = np.stack([straight, sloped], axis=-1) - interpolant  # (c, q, xy, 2 kinks)
    left_over = ((1.0 - share) / q)[:, :, None]
    x, y = beyond[:, :, 0], beyond[:, :, 1]
    weighted_x, weighted_y = np.swapaxes(x * left_over, 1, 2), np.swapaxes(y * left_over, 1, 2)
    mixed = weighted_x @ y
    outside = np.stack([weighted_x @ x, mixed + np.swapaxes(mixed, 1, 2), weighted_y @ y], axis=1)
    within = ((inside * share) @ PRODUCTS).reshape(count, 3, 9, 9)
    corner = outside + np.swapaxes(held, 1, 2)[:, None] @ within @ held[:, None]
    total = np.maximum(share.sum(axis=1), 1e-30)
    return Cuts(
        of_set=of_set,
        element=element,
        sigma=(inside * share).sum(axis=1) / total,
        share=share.mean(axis=1),
        added=added.reshape(count, 3, 9, 9),
        held=held,
        corner=corner,
    )


def middle_tensor(metric: Array, sizes_mm: Array, thickness_m: float) -> Array:
    """Return (n, 3) conductances xx, xy, yy of unit elements at sigma = 1, S, from (n, 3) metrics E, F, G."""
    E, F, G = metric.T
    ratio = sizes_mm[:, 1] / sizes_mm[:, 0]
    return np.asarray(thickness_m / (E * G - F**2) * np.stack([G * ratio, -F, E / ratio])).T


def uniform_blocks(tensor: Array) -> Array:
    """Return the (n, 9, 9) blocks of elements of constant conductance tensors (n, 3)."""
    return np.asarray(np.tensordot(tensor, UNIFORM, axes=(1, 0)))


def _uniform() -> Array:
    nodes, weights = np.polynomial.legendre.leggauss(3)
    line = (nodes + 1.0) / 2
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    weight = np.outer(weights, weights).ravel() / 4
    x, y = gradients(points)
    xy = np.einsum("q,qi,qj->ij", weight, x, y)
    return np.stack([np.einsum("q,qi,qj->ij", weight, x, x), xy + xy.T, np.einsum("q,qi,qj->ij", weight, y, y)])


UNIFORM: Final[npt.NDArray[np.float64]] = _uniform()
"""(3, 9, 9) exact integrals of the products of slopes, by tensor component."""

FLOOR: Final = 1e-11
"""A kink whose energy is below this share of the element's is rounding, and is left out."""


def cut_blocks(cuts: Cuts, tensor: Array, stiffness: Array) -> Array:
    """Return the (c, 9, 9) blocks of cut elements at one deformation.

    Args:
        cuts: Touched elements.
        tensor: (n_elements, 3) conductance at the middles.
        stiffness: (n_elements, 9, 9) S of the untouched elements at 1 S/m.
    """
    element = cuts.element[: cuts.n_cut]
    own = tensor[element]
    added = (own[:, None, :] @ cuts.added.reshape(-1, 3, 81)).reshape(-1, 9, 9)
    corner = (own[:, None, :] @ cuts.corner.reshape(-1, 3, 4)).reshape(-1, 2, 2)
    corner[:, [0, 1], [0, 1]] += FLOOR * (own[:, 0] + own[:, 2])[:, None]
    coupling = added @ cuts.held
    determinant = corner[:, 0, 0] * corner[:, 1, 1] - corner[:, 0, 1] ** 2
    inverse = np.empty_like(corner)
    inverse[:, 0, 0], inverse[:, 1, 1] = corner[:, 1, 1] / determinant, corner[:, 0, 0] / determinant
    inverse[:, 0, 1] = inverse[:, 1, 0] = -corner[:, 0, 1] / determinant
    even = stiffness[element]
    mean = (cuts.share * (cuts.sigma - 1.0))[: cuts.n_cut, None, None]
    change = added - coupling @ inverse @ np.swapaxes(coupling, 1, 2) + mean * (even - uniform_blocks(own))
    return np.asarray(even + change)
