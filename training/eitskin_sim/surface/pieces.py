"""Separates the surfaces of a scan, and chooses the one that has the sheet's size.

Points are binned into cubes; cubes that touch belong to one piece. A piece with too small an area is no sheet, however
many points it has, such as unseen pixels or a patch that was scanned twice. Of larger pieces the one that unrolls to
the sheet's size is taken; of two such sheets neither is.
"""

from collections.abc import Callable
from itertools import product
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph

from eitskin_sim.arrays import Array

CELL_MM: Final = 4.0
"""Side of a cube; with fewer points than ``MIN_POINTS`` in a cube on average, cubes are larger."""

MIN_POINTS: Final = 4.0

MOST_LABELLED: Final = 400_000
"""Points, taken by chance, that decide which cubes touch."""

MIN_AREA: Final = 0.3
"""A piece with fewer cubes than this part of the flat sheet's area is no sheet."""

CROWD: Final = 0.01
"""A piece with a larger part of the points than this is left out if it is not the sheet; fewer are stray points."""

SAME_SIZE: Final = 0.06
"""Sides of the sheet are off by less than this part, in a scan that shows another sheet as well."""

OTHER_SIZE: Final = 0.15
"""The other sheet's are off by more."""

LARGEST_PLACE_MM: Final = 1e5
"""No point farther from the origin takes part."""


def keep_sheet(
    points_mm: Array, flat_mm: tuple[float, float], measure: Callable[[Array], tuple[float, float]]
) -> Array:
    """Return the points without those of other surfaces.

    Args:
        points_mm: (n, 3) finite points.
        flat_mm: The two sides of the flat sheet, the longer first.
        measure: Returns the two sides of a piece; raises ValueError if it is no sheet.

    Raises:
        ValueError: Two pieces could be the sheet.
    """
    points = points_mm[np.all(np.abs(points_mm) < LARGEST_PLACE_MM, axis=1)]
    if len(points) < 2:
        return points
    piece, cell_mm, cubes = _pieces(points)
    held = np.bincount(piece + 1, minlength=len(cubes) + 1)[1:]
    large = np.flatnonzero(cubes >= MIN_AREA * flat_mm[0] * flat_mm[1] / cell_mm**2)
    if not len(large):
        return points
    sheet = int(large[0]) if len(large) == 1 else _choose(points, piece, large, flat_mm, measure)
    other = np.flatnonzero(held > CROWD * len(points))
    other = np.union1d(other, large)
    return points[~np.isin(piece, other[other != sheet])]


def _choose(
    points: Array,
    piece: npt.NDArray[np.intp],
    large: npt.NDArray[np.intp],
    flat_mm: tuple[float, float],
    measure: Callable[[Array], tuple[float, float]],
) -> int:
    """Return the piece that has the sheet's size."""
    found: list[tuple[float, int, str]] = []
    for number in large[:8].tolist():
        own = points[piece == number]
        try:
            size = measure(own)
        except ValueError:
            continue
        off = float(np.abs(np.log(np.divide(size, flat_mm))).max())
        middle = ", ".join(f"{place:.0f}" for place in own.mean(axis=0))
        found.append((off, number, f"{size[0]:.1f} x {size[1]:.1f} mm about ({middle}) mm"))
    found.sort()
    if not found:
        return int(large[0])
    if len(found) > 1 and (found[0][0] > SAME_SIZE or found[1][0] < OTHER_SIZE):
        raise ValueError(
            f"the scan shows {len(found)} surfaces that may be the sheet: {'; '.join(text for _, _, text in found)}: "
            "cut the others off with --crop, --plane or --depth"
        )
    return found[0][1]


def _pieces(points: Array) -> tuple[npt.NDArray[np.intp], float, npt.NDArray[np.intp]]:
    """The piece of every point (-1: of none), the side of the cubes, and how many cubes each piece has."""
    sample = points
    if len(points) > MOST_LABELLED:
        sample = points[np.random.default_rng(0).choice(len(points), MOST_LABELLED, replace=False)]
    cell_mm = CELL_MM
    cube, count = np.unique(_keys(sample, cell_mm), return_counts=True)
    mean = float(count.mean())
    if mean < MIN_POINTS:
        cell_mm *= float(np.sqrt(MIN_POINTS / mean))
        cube, count = np.unique(_keys(sample, cell_mm), return_counts=True)
    cube = cube[count > 1]
    if not len(cube):
        return np.full(len(points), -1, dtype=np.intp), cell_mm, np.zeros(0, dtype=np.intp)
    links = []
    for step in product((-1, 0, 1), repeat=3):
        if step > (0, 0, 0):
            beside = cube + np.dot(step, _STRIDES)
            at = np.minimum(np.searchsorted(cube, beside), len(cube) - 1)
            hit = np.flatnonzero(cube[at] == beside)
            links.append((hit, at[hit]))
    first, second = (np.concatenate(ends) for ends in zip(*links, strict=True))
    graph = sparse.coo_matrix((np.ones(len(first)), (first, second)), shape=(len(cube),) * 2)
    _, label = csgraph.connected_components(graph, directed=False)
    own = _keys(points, cell_mm)
    at = np.minimum(np.searchsorted(cube, own), len(cube) - 1)
    return np.where(cube[at] == own, label[at], -1).astype(np.intp), cell_mm, np.bincount(label)


_STRIDES: Final = np.array([1 << 40, 1 << 20, 1], dtype=np.int64)
"""Of a cube's key: 20 bits an axis."""


def _keys(points: Array, cell_mm: float) -> npt.NDArray[np.int64]:
    cells = (np.floor(points / cell_mm) + (1 << 19)).astype(np.int64)
    return np.asarray(cells @ _STRIDES)
