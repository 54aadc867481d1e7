"""Which elements touches cover or cut, and how, for many touch sets at once: what no deformation changes.

An element is cut by a piece when its border passes through. Its share inside is integrated over ``POINTS`` x ``POINTS``
cells, each cut by a straight line. Pieces of a set that cut one element make one inside: where they abut there is no
seam. What a cut element's block becomes is in :mod:`eitskin_sim.fem.borders.cut_blocks`.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.fem.borders.cut_blocks import Integrals, integrate
from eitskin_sim.fem.borders.cut_rule import UNIT_NODES, WHOLE, half_plane_share, union
from eitskin_sim.fem.borders.enrichment import POINTS, UNIT_POINTS
from eitskin_sim.fem.borders.graded_blocks import CELL, GradedIntegrals, integrate_graded
from eitskin_sim.fem.mesh import Index, TensorMesh
from eitskin_sim.scene.gap import half_extents_mm
from eitskin_sim.scene.parts import LEAST_LOG_CONTRAST
from eitskin_sim.scene.shapes import ellipse_distance, length_of
from eitskin_sim.scene.soft_touch import LEAST_BORDER_MM
from eitskin_sim.scene.touch_table import DISC, ELLIPSE, Array, TouchTable, borders_mm

UNIT: Final = np.concatenate([UNIT_POINTS, UNIT_NODES, [[0.5, 0.5]]])
"""(q + 10, 2) where distances are taken in a unit element: its points, its nodes and its middle."""


@dataclass(frozen=True, slots=True)
class Cuts:
    """Touched elements of several sets, e in all, of which the first c are cut.

    Args:
        of_set: (e,) which set, counted from the first of these.
        element: (e,) which element.
        sigma: (e,) S/m, the mean inside; of those under a graded border the mean.
        share: (e,) of the element's area inside; 1 after the first c.
        integrals: Of the first c.
        graded: Of the g after them, which a graded border reaches; None where there are none.
    """

    of_set: Index
    element: Index
    sigma: Array
    share: Array
    integrals: Integrals
    graded: GradedIntegrals | None = None

    @property
    def n_cut(self) -> int:
        """How many are cut."""
        return len(self.integrals.added)

    @property
    def n_graded(self) -> int:
        """How many a graded border reaches."""
        return 0 if self.graded is None else len(self.graded)


def find_cuts(touches: TouchTable, sets: Index, mesh: TensorMesh, among: npt.NDArray[np.bool_] | None = None) -> Cuts:
    """Return what some touch sets do to a mesh's elements.

    Args:
        touches: The table.
        sets: (s,) which of its sets.
        mesh: The fixed mesh.
        among: (s, n_elements) the elements that are looked at; None for all.

    Raises:
        ValueError: A graded border cannot be represented, or its piece would change nothing.
    """
    counts = np.diff(touches.first)[sets]
    owner = np.repeat(np.arange(len(sets)), counts)
    pieces = touches.pieces[(touches.first[sets] - np.cumsum(counts) + counts)[owner] + np.arange(len(owner))]
    borders = borders_mm(pieces)
    piece, element = _near(pieces, mesh, borders)
    if among is not None:
        wanted = among[owner[piece], element]
        piece, element = piece[wanted], element[wanted]
    graded = None
    if borders.any():
        check_pieces(pieces[borders != 0.0], mesh)
        piece, element, graded = _split_graded(pieces, borders, owner, piece, element, mesh)
    middle, _ = _distance(pieces[piece], mesh.centres_mm[element][:, None, :])
    reach = np.hypot(*mesh.sizes_mm[element].T) / 2
    whole, crossed = middle[:, 0] <= -reach, np.abs(middle[:, 0]) < reach
    pair = _integrate(pieces, piece[crossed], element[crossed], mesh)
    inside = pair.mean > 1.0 - WHOLE
    full = np.concatenate([np.flatnonzero(whole), np.flatnonzero(crossed)[inside]])
    cut = np.flatnonzero((pair.mean > WHOLE) & ~inside)
    united = _unite(pair, cut, owner, mesh)
    covered = (owner[piece[full]], element[full], pieces[piece[full], 6])
    if graded is not None:
        of_set, number, sigma, _ = graded
        covered = (
            np.concatenate([of_set, covered[0]]),
            np.concatenate([number, covered[1]]),
            np.concatenate([sigma, covered[2]]),
        )
    return Cuts(
        of_set=np.concatenate([united.of_set, covered[0]]),
        element=np.concatenate([united.element, covered[1]]),
        sigma=np.concatenate([united.sigma, covered[2]]),
        share=np.concatenate([united.share, np.ones(len(covered[0]))]),
        integrals=united.integrals,
        graded=None if graded is None else graded[3],
    )


def check_pieces(pieces: Array, mesh: TensorMesh) -> None:
    """Raise ValueError if a piece would change nothing, or its border cannot be represented."""
    borders = borders_mm(pieces)
    half, ends = half_extents_mm(pieces), (mesh.x_lines_mm[-1], mesh.y_lines_mm[-1])
    away = ((pieces[:, 1:3] + half <= 0.0) | (pieces[:, 1:3] - half >= ends)).any(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        even = ~(np.abs(np.log(pieces[:, 6])) >= LEAST_LOG_CONTRAST) | ~np.isfinite(np.log(pieces[:, 6]))
    narrow = pieces[:, 3] if len(pieces) == 0 else np.where(pieces[:, 0] == DISC, pieces[:, 3], pieces[:, 3:5].min(1))
    thin = (borders > 0.0) & ((borders < LEAST_BORDER_MM) | (borders > narrow)) | ~(borders >= 0.0)
    for wrong, what in (
        (away, f"outside the sheet of {ends[0]:g} x {ends[1]:g} mm, where it changes nothing"),
        (even, "contrast must be above 0 and differ from 1, or the touch changes nothing"),
        (~(narrow > 0.0), "sides must be above 0 mm, or the touch changes nothing"),
        (thin, f"a graded border must be from {LEAST_BORDER_MM:g} mm to the touch's width, a sharp one 0"),
    ):
        if wrong.any():
            number = int(np.argmax(wrong))
            found = ", ".join(f"{value:g}" for value in pieces[number])
            raise ValueError(f"piece {number} (kind, x, y, length, width, angle, contrast, border: {found}): {what}")


def _near(pieces: Array, mesh: TensorMesh, borders: Array) -> tuple[Index, Index]:
    """Return pairs of piece and element whose boxes meet."""
    half = half_extents_mm(pieces) + borders[:, None] / 2
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


def _split_graded(
    pieces: Array, borders: Array, owner: Index, piece: Index, element: Index, mesh: TensorMesh
) -> tuple[Index, Index, tuple[Index, Index, Array, GradedIntegrals]]:
    """Return the pairs out of graded borders' reach, and of the elements within: set, number, sigma and integrals.

    What lies inside a graded border alone, at its full contrast, is like what lies inside a sharp one.
    """
    key = owner[piece] * mesh.n_elements + element
    centre = _distance(pieces[piece], mesh.centres_mm[element][:, None, :])[0][:, 0]
    soft, span = borders[piece] > 0.0, borders[piece] / 2 + np.hypot(*mesh.sizes_mm[element].T) / 2
    inner, times = np.unique(key[soft & (centre < span)], return_counts=True)
    crossed = np.concatenate([key[soft & (np.abs(centre) < span)], inner[times > 1]])
    passed = soft & (centre >= span)
    maybe = np.flatnonzero(np.isin(key, crossed) & ~passed)  # the others need no distances at their points
    sizes = mesh.sizes_mm[element[maybe]]
    where = mesh.corners_mm[element[maybe]][:, None, :] + UNIT * sizes[:, None, :]
    distance, normal = _distance(pieces[piece[maybe]], where)
    half = borders[piece[maybe]] / 2
    beyond, within = distance.min(axis=1) >= half, distance.max(axis=1) <= -half
    reached = key[maybe[~beyond & ~within & (half > 0.0)]]
    crowded, count = np.unique(key[maybe[~beyond & (half > 0.0)]], return_counts=True)
    own = ~beyond & np.isin(key[maybe], np.concatenate([reached, crowded[count > 1]]))
    taken = maybe[own]
    away = (half > 0.0) & beyond
    kept = np.ones(len(piece), dtype=np.bool_)
    kept[taken] = kept[maybe[away]] = kept[passed] = False
    order = np.argsort(key[taken], kind="stable")
    rows, taken = np.flatnonzero(own)[order], taken[order]
    unique, group = np.unique(key[taken], return_inverse=True)
    sides = mesh.sizes_mm[unique % mesh.n_elements]
    least = CELL * sides.max(axis=1)[group]
    log_contrast = np.log(pieces[piece[taken], 6])
    border = np.maximum(borders[piece[taken]], least)
    graded = integrate_graded(group, sides, distance[rows], normal[rows], log_contrast, border)
    return piece[kept], element[kept], (unique // mesh.n_elements, unique % mesh.n_elements, graded.sigma, graded)


def _distance(pieces: Array, points: Array) -> tuple[Array, Array]:
    """Return signed distances (n, q) and outward normals (n, q, 2) of points (n, q, 2) from (n, 7) pieces."""
    offset = points - pieces[:, None, 1:3]
    turn = np.deg2rad(pieces[:, 5])
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    upright = not turn.any()
    local_x, local_y = offset[..., 0], offset[..., 1]
    if not upright:
        local_x, local_y = cos * local_x + sin * local_y, cos * local_y - sin * local_x
    beyond_x = np.abs(local_x) - pieces[:, None, 3] / 2
    beyond_y = np.abs(local_y) - pieces[:, None, 4] / 2
    out_x, out_y = np.maximum(beyond_x, 0.0), np.maximum(beyond_y, 0.0)
    away = length_of(out_x, out_y)
    distance = away + np.minimum(np.maximum(beyond_x, beyond_y), 0.0)
    outside = away > 0.0
    along_x = beyond_x >= beyond_y
    safe = np.where(outside, away, 1.0)
    normal_x = np.where(outside, out_x / safe, along_x) * np.where(local_x < 0.0, -1.0, 1.0)
    normal_y = np.where(outside, out_y / safe, ~along_x) * np.where(local_y < 0.0, -1.0, 1.0)
    if not upright:
        normal_x, normal_y = cos * normal_x - sin * normal_y, sin * normal_x + cos * normal_y
    normal = np.stack([normal_x, normal_y], axis=-1)
    ovals = np.flatnonzero(pieces[:, 0] == ELLIPSE)
    if len(ovals):
        local = np.stack([local_x[ovals], local_y[ovals]], axis=-1)
        distance[ovals], own = ellipse_distance(local, pieces[ovals, None, 3:5] / 2)
        c, s = cos[ovals], sin[ovals]
        normal[ovals] = np.stack([c * own[..., 0] - s * own[..., 1], s * own[..., 0] + c * own[..., 1]], axis=-1)
    round_ones = np.flatnonzero(pieces[:, 0] == DISC)
    if len(round_ones):
        radius = length_of(offset[round_ones, :, 0], offset[round_ones, :, 1])
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
    sizes = mesh.sizes_mm[element]
    where = mesh.corners_mm[element][:, None, :] + UNIT * sizes[:, None, :]
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
