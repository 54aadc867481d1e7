"""Which elements touches cover or cut, and how, for many touch sets at once: what no deformation changes.

An element is cut by a piece when its border passes through. Its share inside is integrated over ``POINTS`` x ``POINTS``
cells, each cut by a straight line. Pieces of a set that cut one element make one inside: where they abut there is no
seam. What a cut element's block becomes is in :mod:`eitskin_sim.fem.cut_blocks`.
"""

from dataclasses import dataclass

import numpy as np

from eitskin_sim.fem.cut_blocks import POINTS, UNIT_POINTS, Integrals, integrate
from eitskin_sim.fem.cut_rule import UNIT_NODES, WHOLE, half_plane_share, union
from eitskin_sim.fem.mesh import Index, TensorMesh
from eitskin_sim.scene.gap import half_extents_mm
from eitskin_sim.scene.touch_table import DISC, Array, TouchTable


@dataclass(frozen=True, slots=True)
class Cuts:
    """Touched elements of several sets, e in all, of which the first c are cut.

    Args:
        of_set: (e,) which set, counted from the first of these.
        element: (e,) which element.
        sigma: (e,) S/m, the mean inside.
        share: (e,) of the element's area inside; 1 after the first c.
        integrals: Of the first c.
    """

    of_set: Index
    element: Index
    sigma: Array
    share: Array
    integrals: Integrals

    @property
    def n_cut(self) -> int:
        """How many are cut."""
        return len(self.integrals.added)


def find_cuts(touches: TouchTable, sets: Index, mesh: TensorMesh) -> Cuts:
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
        integrals=united.integrals,
    )


def _near(pieces: Array, mesh: TensorMesh) -> tuple[Index, Index]:
    """Return pairs of piece and element whose boxes meet."""
    half = half_extents_mm(pieces)
    low, high = pieces[:, 1:3] - half, pieces[:, 1:3] + half
    ny, nx = mesh.shape
    first_x = np.clip(np.searchsorted(mesh.x_lines_mm, low[:, 0], side="right") - 1, 0, nx - 1)
    last_x = np.clip(np.searchsorted(mesh.x_lines_mm, high[:, 0], side="left"), 1, nx)
    first_y = np.clip(np.searchsorted(mesh.y_lines_mm, low[:, 1], side="right") - 1, 0, ny - 1)
    last_y = np.clip(np.searchsorted(mesh.y_lines_mm, high[:, 1], side="left"), 1, ny)
    wide, tall = last_x - first_x, last_y - first_y
    piece = np.repeat(np.arange(len(pieces)), wide * tall)
    count = np.arange(len(piece)) - np.repeat(np.cumsum(wide * tall) - wide * tall, wide * tall)
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
        share[row] = union(share[row], pair.share[own], facing)
        distance[row] = np.where(nearer, pair.distance[own], distance[row])
        normal[row] = np.where(nearer[..., None], pair.normal[own], normal[row])
    element, total = pair.element[first], np.maximum(share.sum(axis=1), 1e-30)
    return Cuts(
        of_set=owner[pair.piece[first]],
        element=element,
        sigma=(inside * share).sum(axis=1) / total,
        share=share.mean(axis=1),
        integrals=integrate(mesh.sizes_mm[element], distance, normal, share, inside),
    )
