"""A flat chart of a curled sheet: every measured point gets the place (u, v) that it has when the sheet is rolled out.

A sheet bent by 180 degrees or more is no graph z(x, y), so nothing here looks from above. The points are binned into
cubes of a few millimetres, and the cubes' centroids c form a graph along the surface::

    tangent frame at each centroid   principal directions of its neighbourhood
    frames made consistent           parallel transport outwards from the middle, then averaging between neighbours
    (u, v) of the centroids          least squares: uv_j - uv_i = arc from c_i to c_j, seen in the frames
    (u, v) of every point            its own cube's frame

On a developable surface (a bend of any angle, axis and skew) the least squares have an exact solution; twist and bumps
leave a few tenths of a millimetre, which the resampling by arc length takes out afterwards. Outliers go in three
sieves: cubes with too few points, cubes that do not hang together with the rest, points too far off their cube's
curved surface.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from eitskin_sim.arrays import Array

CELL_MM: Final = 4.0
"""Side of a cube. Under it the noise is not averaged, over it curvature and close layers are lost."""

REACH_CELLS: Final = 2.2
"""Cubes this near, in cells, are neighbours; layers of a curled sheet must lie farther apart (9 mm)."""

MAX_EXTENT_DIAGONALS: Final = 1.45
"""No point of the sheet is farther than this many diagonals of the flat one from its median point: stretched by 1.4 at
most, and seen from a corner."""

SPARSE_CUBE: Final = 0.15
"""A cube with less than this part of the median count is no part of the graph."""

MIN_POINTS_PER_CUBE: Final = 4.0
"""With fewer points in a cube on average the cubes are made larger; points 2 mm apart have 3.4."""

WANTED_POINTS_PER_CUBE: Final = 5.0
"""Average number of points in a larger cube."""

MIN_CELLS: Final = 50
"""A surface of fewer cubes than this is no sheet."""

AVERAGINGS: Final = 6
"""Rounds in which each tangent is averaged with its neighbours'."""

MIN_OUTLIER_DISTANCE_MM: Final = 0.05
"""A point this near its cube's surface is never an outlier, however little noise there is."""

OUTLIER_SIGMAS: Final = 5.0
"""A point this many robust standard deviations off its cube's surface is an outlier."""


@dataclass(frozen=True, slots=True)
class Chart:
    """Points of the sheet with their place on a flat plane."""

    points_mm: Array
    """(3, n) the points that belong to the sheet, in the points' frame."""
    uv_mm: Array
    """(2, n) where each lies on the rolled-out sheet: lengths are true, the origin and the directions are arbitrary."""
    noise_mm: float
    """Robust standard deviation of the points off the surface."""
    outliers: int
    """Points left out."""


def unroll(points_mm: Array, size_mm: tuple[float, float]) -> Chart:
    """Return a flat chart of unordered points, without its outliers.

    Args:
        points_mm: (n, 3) points in any pose.
        size_mm: Length and width of the flat sheet.

    Raises:
        ValueError: The points do not form one surface.
    """
    axes = np.ascontiguousarray(points_mm.T)  # (3, n): gathers along a long last axis are several times faster
    middle = np.median(axes[:, :: len(points_mm) // 5000 + 1], axis=1, keepdims=True)
    near = np.all(np.abs(axes - middle) < MAX_EXTENT_DIAGONALS * math.hypot(*size_mm), axis=0)
    axes = axes if near.all() else np.ascontiguousarray(axes[:, near])
    cell_mm = CELL_MM
    cube, count = _bin(axes, cell_mm)
    if count.mean() < MIN_POINTS_PER_CUBE:
        cell_mm *= float(np.sqrt(WANTED_POINTS_PER_CUBE / count.mean()))
        cube, count = _bin(axes, cell_mm)
    centroid = np.stack([np.bincount(cube, weights=axis) for axis in axes], axis=-1) / count[:, None]
    solid = count >= max(2.0, SPARSE_CUBE * float(np.median(count[count > 1.0])) if (count > 1.0).any() else 0.0)
    keep = _largest_piece(centroid, solid, REACH_CELLS * cell_mm)
    if len(keep) < MIN_CELLS:
        raise ValueError(
            f"only {len(keep)} cells of {cell_mm:g} mm hold a connected surface; a sheet has about "
            f"{size_mm[0] * size_mm[1] / CELL_MM**2:.0f} of {CELL_MM:g} mm: "
            "are the points in millimetres, and of the whole sheet?"
        )
    nodes = centroid[keep]
    pairs = cKDTree(nodes).query_pairs(REACH_CELLS * cell_mm, output_type="ndarray")
    frame, curvature = _frames(nodes, pairs[:, 0], pairs[:, 1])
    uv = _integrate(nodes, frame, pairs[:, 0], pairs[:, 1])
    return _place(
        axes, _node_of_cube(centroid, keep, 2.0 * cell_mm)[cube], nodes, frame, curvature, uv, total=len(points_mm)
    )


def _bin(axes: Array, cell_mm: float) -> tuple[npt.NDArray[np.intp], Array]:
    """Cube of every point, cubes numbered without gaps, and the number of points in each."""
    key = np.zeros(axes.shape[1], dtype=np.int64)
    size = 1
    for axis in axes:
        cell = ((axis - axis.min()) / cell_mm).astype(np.int64)
        width = int(cell.max()) + 1
        key *= width
        key += cell
        size *= width
    count = np.bincount(key, minlength=size)
    number = np.cumsum(count > 0) - 1
    return np.asarray(number[key], dtype=np.intp), count[count > 0].astype(np.float64)


def _largest_piece(centroid: Array, solid: npt.NDArray[np.bool_], reach_mm: float) -> npt.NDArray[np.intp]:
    candidates = np.flatnonzero(solid)
    pairs = cKDTree(centroid[candidates]).query_pairs(reach_mm, output_type="ndarray")
    n = len(candidates)
    graph = sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, label = csgraph.connected_components(graph, directed=False)
    return np.asarray(candidates[label == np.bincount(label).argmax()])


def _frames(nodes: Array, first: npt.NDArray[np.intp], second: npt.NDArray[np.intp]) -> tuple[Array, Array]:
    """(n, 3, 3) rows t1, t2, normal, alike between neighbours, and (n, 2, 2) the curvature form in t1, t2."""
    n = len(nodes)
    both, other = np.concatenate([first, second]), np.concatenate([second, first])
    step = nodes[other] - nodes[both]
    moments = np.stack(
        [np.bincount(both, weights=step[:, a] * step[:, b], minlength=n) for a in range(3) for b in range(3)], axis=-1
    ).reshape(n, 3, 3)
    normal = np.linalg.eigh(moments)[1][:, :, 0]
    root = int(np.argmin(np.sum((nodes - nodes.mean(axis=0)) ** 2, axis=1)))
    tangent = _transport(normal, root, sparse.csr_matrix((np.ones(len(both)), (both, other)), shape=(n, n)))
    frame = np.stack([tangent, np.cross(normal, tangent), normal], axis=1)
    along = np.einsum("eij,ej->ei", frame[both, :2], step)  # the neighbour's place in the tangent plane
    turn = -np.einsum("eij,ej->ei", frame[both, :2], normal[other] - normal[both])
    return frame, _curvature(both, along, turn, n)


def _curvature(both: npt.NDArray[np.intp], along: Array, turn: Array, n: int) -> Array:
    """Least squares of turn = H along at every node, made symmetric."""
    gram = np.stack([np.bincount(both, along[:, a] * along[:, b], n) for a in range(2) for b in range(2)], -1)
    cross = np.stack([np.bincount(both, turn[:, a] * along[:, b], n) for a in range(2) for b in range(2)], -1)
    gram = gram.reshape(n, 2, 2) + 1e-3 * np.trace(gram.reshape(n, 2, 2), axis1=1, axis2=2)[:, None, None] * np.eye(2)
    form = np.swapaxes(np.linalg.solve(gram, np.swapaxes(cross.reshape(n, 2, 2), 1, 2)), 1, 2)
    return np.asarray(0.5 * (form + np.swapaxes(form, 1, 2)))


def _transport(normal: Array, root: int, graph: sparse.csr_matrix) -> Array:
    """First tangents (n, 3), carried from the root and then averaged; makes the normals point to one side in place."""
    order, parent = csgraph.breadth_first_order(graph, root, directed=False)
    depth = np.zeros(len(normal), dtype=np.intp)
    for node in order[1:].tolist():
        depth[node] = depth[parent[node]] + 1
    tangent = np.zeros_like(normal)
    tangent[root] = _project(np.eye(3)[int(np.argmin(np.abs(normal[root])))][None], normal[root][None])[0]
    ranked = order[np.argsort(depth[order], kind="stable")]
    for level in np.split(ranked, np.flatnonzero(np.diff(depth[ranked])) + 1)[1:]:
        above = parent[level]
        normal[level] *= np.where(np.sum(normal[level] * normal[above], axis=1) < 0.0, -1.0, 1.0)[:, None]
        tangent[level] = _project(tangent[above], normal[level])
    for _ in range(AVERAGINGS):
        tangent = _project(graph @ tangent + tangent, normal)
    return tangent


def _project(vectors: Array, normal: Array) -> Array:
    flat = vectors - np.sum(vectors * normal, axis=1, keepdims=True) * normal
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12))


def _integrate(nodes: Array, frame: Array, first: npt.NDArray[np.intp], second: npt.NDArray[np.intp]) -> Array:
    """(n, 2) from the arcs between neighbours, by least squares."""
    n = len(nodes)
    chord = nodes[second] - nodes[first]
    seen = np.einsum("eij,ej->ei", frame[first, :2] + frame[second, :2], chord)
    cosine = np.clip(np.sum(frame[first, 2] * frame[second, 2], axis=1), -1.0, 1.0)
    half = 0.5 * np.arccos(cosine)
    length = np.linalg.norm(chord, axis=1) * np.where(half > 1e-4, half / np.maximum(np.sin(half), 1e-12), 1.0)
    arc = seen * (length / np.maximum(np.linalg.norm(seen, axis=1), 1e-12))[:, None]
    ones = np.ones(len(first))
    incidence = sparse.csr_matrix(
        (np.concatenate([-ones, ones]), (np.tile(np.arange(len(first)), 2), np.concatenate([first, second]))),
        shape=(len(first), n),
    )
    pinned = incidence.T @ incidence + sparse.csr_matrix(([1.0], ([0], [0])), shape=(n, n))
    return np.asarray(splu(pinned.tocsc(), permc_spec="MMD_AT_PLUS_A").solve(np.asarray(incidence.T @ arc)))


def _node_of_cube(centroid: Array, keep: npt.NDArray[np.intp], reach_mm: float) -> npt.NDArray[np.intp]:
    """The graph's node that places a cube's points: its own, the nearest within reach, or none (-1)."""
    node = np.full(len(centroid), -1, dtype=np.intp)
    node[keep] = np.arange(len(keep))
    unplaced = np.flatnonzero(node < 0)
    distance, nearest = cKDTree(centroid[keep]).query(centroid[unplaced], distance_upper_bound=reach_mm)
    node[unplaced] = np.where(np.isfinite(distance), nearest, -1)
    return node


def _place(
    axes: Array, node: npt.NDArray[np.intp], nodes: Array, frame: Array, curvature: Array, uv: Array, *, total: int
) -> Chart:
    """Every point in its node's frame, and out with those too far off the node's curved surface."""
    reached = node >= 0
    if not reached.all():
        node, axes = node[reached], np.ascontiguousarray(axes[:, reached])
    local = []
    for direction in range(3):
        rows = np.ascontiguousarray(frame[:, direction])
        offset = np.sum(rows * nodes, axis=1)
        local.append(sum(rows[:, a].take(node) * axes[a] for a in range(3)) - offset.take(node))
    first, second, off = local
    off -= first * (0.5 * curvature[:, 0, 0].take(node) * first + curvature[:, 0, 1].take(node) * second)
    off -= 0.5 * curvature[:, 1, 1].take(node) * second**2
    sample = off[:: len(off) // 20000 + 1]
    centre = float(np.median(sample))
    noise = 1.4826 * float(np.median(np.abs(sample - centre)))
    on = np.abs(off - centre) <= max(OUTLIER_SIGMAS * noise, MIN_OUTLIER_DISTANCE_MM)
    place = np.stack([uv[:, 0].take(node) + first, uv[:, 1].take(node) + second])
    return Chart(axes[:, on], place[:, on], noise, total - int(on.sum()))
