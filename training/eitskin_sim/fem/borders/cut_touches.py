"""Finds the elements that touches cover or cut, for many touch sets at once; independent of the deformation.

An element is cut by a piece when its border passes through. Its share inside is integrated over ``POINTS`` x ``POINTS``
cells, each cut by a straight line. Pieces of a set that cut one element make one inside: where they abut there is no
seam. Scenes, of any shapes, are cut by the same rule (:mod:`eitskin_sim.fem.borders.cut_elements`).
:mod:`eitskin_sim.fem.borders.cut_blocks` computes a cut element's block.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.borders.cut_blocks import Integrals, integrate
from eitskin_sim.fem.borders.cut_rule import SHARE_TOLERANCE, UNIT_NODES, half_plane_share, union
from eitskin_sim.fem.borders.enrichment import POINTS, UNIT_POINTS
from eitskin_sim.fem.borders.graded_blocks import MIN_BORDER, GradedIntegrals, integrate_graded
from eitskin_sim.fem.mesh import TensorMesh
from eitskin_sim.scene.gap import half_extents_mm
from eitskin_sim.scene.parts import MIN_LOG_CONTRAST
from eitskin_sim.scene.shapes import ellipse_distance, length_of
from eitskin_sim.scene.soft_touch import MIN_BORDER_MM
from eitskin_sim.scene.touch_table import DISC, ELLIPSE, TouchTable, borders_mm

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
    middle = _distance(pieces[piece], mesh.centres_mm[element][:, None, :])[:, 0]
    reach = mesh.reach_mm[element]
    whole, crossed = middle <= -reach, np.abs(middle) < reach
    own = piece[crossed]

    def border(points: Array) -> tuple[Array, Array]:
        return _border(pieces[own], points)

    pairs = pairs_of(border, element[crossed], pieces[own, 6], mesh, owner[own])
    inside = pairs.mean > 1.0 - SHARE_TOLERANCE
    full = np.concatenate([np.flatnonzero(whole), np.flatnonzero(crossed)[inside]])
    cut = united(pairs.chosen((pairs.mean > SHARE_TOLERANCE) & ~inside), mesh)
    covered = (owner[piece[full]], element[full], pieces[piece[full], 6])
    if graded is not None:
        of_set, number, sigma, _ = graded
        covered = (
            np.concatenate([of_set, covered[0]]),
            np.concatenate([number, covered[1]]),
            np.concatenate([sigma, covered[2]]),
        )
    return Cuts(
        of_set=np.concatenate([cut.of_set, covered[0]]),
        element=np.concatenate([cut.element, covered[1]]),
        sigma=np.concatenate([cut.sigma, covered[2]]),
        share=np.concatenate([cut.share, np.ones(len(covered[0]))]),
        integrals=cut.integrals,
        graded=None if graded is None else graded[3],
    )


def check_pieces(pieces: Array, mesh: TensorMesh) -> None:
    """Raise ValueError if a piece would change nothing, or its border cannot be represented."""
    borders = borders_mm(pieces)
    half, ends = half_extents_mm(pieces), (mesh.x_lines_mm[-1], mesh.y_lines_mm[-1])
    away = ((pieces[:, 1:3] + half <= 0.0) | (pieces[:, 1:3] - half >= ends)).any(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        even = ~(np.abs(np.log(pieces[:, 6])) >= MIN_LOG_CONTRAST) | ~np.isfinite(np.log(pieces[:, 6]))
    narrow = pieces[:, 3] if len(pieces) == 0 else np.where(pieces[:, 0] == DISC, pieces[:, 3], pieces[:, 3:5].min(1))
    thin = (borders > 0.0) & ((borders < MIN_BORDER_MM) | (borders > narrow)) | ~(borders >= 0.0)
    for wrong, what in (
        (away, f"outside the sheet of {ends[0]:g} x {ends[1]:g} mm, where it changes nothing"),
        (even, "contrast must be above 0 and differ from 1, or the touch changes nothing"),
        (~(narrow > 0.0), "sides must be above 0 mm, or the touch changes nothing"),
        (thin, f"a graded border must be from {MIN_BORDER_MM:g} mm to the touch's width, a sharp one 0"),
    ):
        if wrong.any():
            number = int(np.argmax(wrong))
            found = ", ".join(f"{value:g}" for value in pieces[number])
            raise ValueError(f"piece {number} (kind, x, y, length, width, angle, contrast, border: {found}): {what}")


def _near(pieces: Array, mesh: TensorMesh, borders: Array) -> tuple[Index, Index]:
    """Return pairs of piece and element whose boxes meet."""
    half = half_extents_mm(pieces) + borders[:, None] / 2
    low, high = pieces[:, 1:3] - half, pieces[:, 1:3] + half
    nx = mesh.shape[1]
    first_x, last_x = _span(mesh.x_lines_mm, low[:, 0], high[:, 0])
    first_y, last_y = _span(mesh.y_lines_mm, low[:, 1], high[:, 1])
    wide, tall = last_x - first_x, last_y - first_y
    piece = np.repeat(np.arange(len(pieces)), wide * tall)
    count = np.arange(len(piece)) - np.repeat(np.cumsum(wide * tall) - wide * tall, wide * tall)
    row, column = np.divmod(count, wide[piece])
    return piece, (first_y[piece] + row) * nx + first_x[piece] + column


def _span(lines: Array, low: Array, high: Array) -> tuple[Index, Index]:
    """Return the first interval between lines that each reaches, one at least, and the one behind the last."""
    count = len(lines) - 1
    first = np.minimum(np.maximum(lines.searchsorted(low, side="right") - 1, 0), count - 1)
    return first, np.minimum(np.maximum(lines.searchsorted(high), 1), count)


def _split_graded(
    pieces: Array, borders: Array, owner: Index, piece: Index, element: Index, mesh: TensorMesh
) -> tuple[Index, Index, tuple[Index, Index, Array, GradedIntegrals]]:
    """Return the pairs out of graded borders' reach, and of the elements within: set, number, sigma and integrals.

    What lies inside a graded border alone, at its full contrast, is like what lies inside a sharp one.
    """
    key = owner[piece] * mesh.n_elements + element
    centre = _distance(pieces[piece], mesh.centres_mm[element][:, None, :])[:, 0]
    soft, span = borders[piece] > 0.0, borders[piece] / 2 + mesh.reach_mm[element]
    inner, times = np.unique(key[soft & (centre < span)], return_counts=True)
    crossed = np.concatenate([key[soft & (np.abs(centre) < span)], inner[times > 1]])
    passed = soft & (centre >= span)
    maybe = np.flatnonzero(np.isin(key, crossed) & ~passed)  # the others need no distances at their points
    distance, normal = _border(pieces[piece[maybe]], _points(element[maybe], mesh))
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
    least = MIN_BORDER * sides.max(axis=1)[group]
    log_contrast = np.log(pieces[piece[taken], 6])
    border = np.maximum(borders[piece[taken]], least)
    graded = integrate_graded(group, sides, distance[rows], normal[rows], log_contrast, border)
    return piece[kept], element[kept], (unique // mesh.n_elements, unique % mesh.n_elements, graded.sigma, graded)


def _points(element: Index, mesh: TensorMesh) -> Array:
    """Return (n, q + 10, 2) where distances are taken, all x of an element in a row and then all y."""
    found = UNIT.T * mesh.sizes_mm[element][:, :, None]
    found += mesh.corners_mm[element][:, :, None]
    return found.swapaxes(1, 2)


def _from_sides(pieces: Array, points: Array) -> tuple[Array, Array, Array, Array]:
    """Return what points (n, q, 2) are to (n, 7) pieces that are taken for rectangles.

    These are (n, q, 2) places in the pieces' axes, (n, q) mm beyond the nearer sides along and across, and distances.
    """
    local = points - pieces[:, None, 1:3]
    turn = np.deg2rad(pieces[:, 5])
    if turn.any():
        cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
        x, y = local[..., 0], local[..., 1]
        local = np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)
    half = pieces[:, None, 3:5] / 2
    along, across = np.abs(local[..., 0]) - half[..., 0], np.abs(local[..., 1]) - half[..., 1]
    outside = length_of(np.maximum(along, 0.0), np.maximum(across, 0.0))
    return local, along, across, outside + np.minimum(np.maximum(along, across), 0.0)


def _distance(pieces: Array, points: Array) -> Array:
    """Return signed distances (n, q) of points (n, q, 2) from (n, 7) pieces."""
    local, _, _, distance = _from_sides(pieces, points)
    for rows in _round_ones(pieces):
        distance[rows] = _from_round(pieces[rows], local[rows])[0]
    return distance


def _border(pieces: Array, points: Array) -> tuple[Array, Array]:
    """Return signed distances (n, q) and outward normals (n, q, 2) of points (n, q, 2) from (n, 7) pieces."""
    local, along, across, distance = _from_sides(pieces, points)
    normal = np.empty((len(pieces), 2, points.shape[1])).swapaxes(1, 2)  # all x in a row, as points
    outside, beside = distance > 0.0, along >= across
    for axis, (beyond, nearer) in enumerate(((along, beside), (across, ~beside))):
        steep = np.divide(np.maximum(beyond, 0.0), distance, out=nearer.astype(np.float64), where=outside)
        np.copysign(steep, local[..., axis], out=normal[..., axis])
    for rows in _round_ones(pieces):
        distance[rows], normal[rows] = _from_round(pieces[rows], local[rows])
    turn = np.deg2rad(pieces[:, 5])
    if turn.any():
        cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
        x, y = normal[..., 0], normal[..., 1]
        normal = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
    return distance, normal


def _round_ones(pieces: Array) -> list[Index]:
    """Return which pieces are discs, and which are ellipses, as far as there are some."""
    return [rows for kind in (DISC, ELLIPSE) if len(rows := np.flatnonzero(pieces[:, 0] == kind))]


def _from_round(pieces: Array, local: Array) -> tuple[Array, Array]:
    """Return signed distances and normals of points in the axes of discs, or of ellipses."""
    if pieces[0, 0] == ELLIPSE:
        return ellipse_distance(local, pieces[:, None, 3:5] / 2)
    radius = length_of(local[..., 0], local[..., 1])
    return radius - pieces[:, None, 3] / 2, local / np.maximum(radius, 1e-12)[..., None]


@dataclass(frozen=True, slots=True)
class Pairs:
    """Pieces of touches and elements that they may cut, n pairs."""

    element: Index
    owner: Index
    """(n,) which set the piece belongs to."""
    sigma: Array
    """(n,) S/m of the piece."""
    distance: Array
    """(n, q + 10) mm at the points, the nodes and the middle."""
    normal: Array
    """(n, q + 10, 2)"""
    share: Array
    """(n, q) of each point's cell inside."""

    @property
    def mean(self) -> Array:
        """(n,) share of the element inside."""
        return np.asarray(self.share.mean(axis=1))

    def chosen(self, which: npt.NDArray[np.bool_] | Index) -> "Pairs":
        """Return some of them."""
        return Pairs(*(getattr(self, name)[which] for name in self.__slots__))

    @classmethod
    def together(cls, parts: Sequence["Pairs"]) -> "Pairs":
        """Return all of several, in their order."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__slots__))

    @classmethod
    def none(cls) -> "Pairs":
        """Return no pairs."""
        no, q = np.zeros(0, dtype=np.intp), len(UNIT)
        return cls(no, no, np.zeros(0), np.zeros((0, q)), np.zeros((0, q, 2)), np.zeros((0, len(UNIT_POINTS))))


Border = Callable[[Array], tuple[Array, Array]]
"""Points (n, q, 2) mm of n elements -> signed distances (n, q) from their pieces' borders, and outward normals."""


def pairs_of(border: Border, element: Index, sigma: Array, mesh: TensorMesh, owner: Index | None = None) -> Pairs:
    """Return pairs of elements with pieces of conductivities (n,), whose borders are given."""
    distance, normal = border(_points(element, mesh))
    q = len(UNIT_POINTS)
    share = half_plane_share(distance[:, :q], normal[:, :q], mesh.sizes_mm[element][:, None, :] / POINTS)
    return Pairs(element, np.zeros_like(element) if owner is None else owner, sigma, distance, normal, share)


def united(pairs: Pairs, mesh: TensorMesh, outside: Array | None = None) -> Cuts:
    """Return cut elements, each once a set: pieces in one element make one inside, later ones over earlier ones.

    Args:
        pairs: Pieces and elements.
        mesh: The elements'.
        outside: (n_elements,) S/m of elements beside the pieces; None is 1. Integrals are over this.
    """
    key = pairs.owner * mesh.n_elements + pairs.element
    order = np.argsort(key, kind="stable")
    pairs, key = pairs.chosen(order), key[order]
    fresh = np.append(True, key[1:] != key[:-1]) if len(key) else np.zeros(0, dtype=np.bool_)
    group = np.cumsum(fresh) - 1
    first = np.flatnonzero(fresh)
    q = len(UNIT_POINTS)
    distance, normal, share = pairs.distance[first], pairs.normal[first], pairs.share[first]
    inside = np.repeat(pairs.sigma[first][:, None], q, axis=1)
    rank = np.arange(len(key)) - first[group] if len(key) else group
    for level in range(1, int(rank.max(initial=0)) + 1):
        own, row = pairs.chosen(rank == level), group[rank == level]
        nearer = own.distance < distance[row]
        facing = np.einsum("kqa,kqa->kq", own.normal[:, :q], normal[row][:, :q])
        later = (own.share >= 0.5) | nearer[:, :q] & (share[row] < 0.5)
        inside[row] = np.where(later, own.sigma[:, None], inside[row])
        share[row] = union(share[row], own.share, facing)
        distance[row] = np.where(nearer, own.distance, distance[row])
        normal[row] = np.where(nearer[..., None], own.normal, normal[row])
    element, total = pairs.element[first], np.maximum(share.sum(axis=1), 1e-30)
    sigma = (inside * share).sum(axis=1) / total
    if outside is not None:
        inside = inside / outside[element, None]
    return Cuts(
        of_set=pairs.owner[first],
        element=element,
        sigma=sigma,
        share=share.mean(axis=1),
        integrals=integrate(mesh.sizes_mm[element], distance, normal, share, inside),
    )
