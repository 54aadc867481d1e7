"""The surface under a map: for a place on the flat sheet, its position in space, its normal and its stretch.

The cloud's points are the pixels' centres. Between four of them the positions and the normals are bilinear; half a
pixel beyond the outermost points they are extrapolated. The normal is the direction of x times that of y, as z is on
the flat sheet. The pose is the cloud's own.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.grid import Grid

Array = npt.NDArray[np.float64]

COLLAPSED: Final = 1e-6
"""Surface over flat area of a pixel that has none worth the name: it faces no way."""


class Surface:
    """A measured surface, prepared for looking places up; immutable, so that it may cross threads.

    Args:
        cloud_mm: (3, rows, columns), finite, in any pose.
        grid: Of the skin.
    """

    __slots__ = ("_columns", "_nodes", "_pixel_mm", "_rows", "stretch")

    def __init__(self, cloud_mm: npt.NDArray[np.floating], grid: Grid) -> None:
        self._rows, self._columns = grid.shape
        self._pixel_mm = dx, dy = grid.pixel_mm
        points = np.asarray(cloud_mm, dtype=np.float64)
        along_x, along_y = _slope(points, 2) / dx, _slope(points, 1) / dy
        normals = np.cross(along_x, along_y, axis=0)
        size = np.sqrt((normals * normals).sum(axis=0))
        faces = size > COLLAPSED
        normals = np.where(faces, normals / np.where(faces, size, 1.0), 0.0)
        self._nodes = np.concatenate([points, normals]).reshape(6, -1).T.copy()
        self.stretch = np.pad(np.where(faces, size, 0.0), 1).reshape(-1)
        """(pixels,) surface over flat area at each pixel of a map with a border, whose own is 0."""

    def at(self, x_mm: Sequence[float], y_mm: Sequence[float]) -> list[list[float]]:
        """Return six numbers for each place: its position in space in mm, and its unit normal.

        A normal is 0, 0, 0 where the surface has none.

        Args:
            x_mm: (n,) on the flat sheet.
            y_mm: (n,) the same.
        """
        (dx, dy), columns, last_column, last_row = self._pixel_mm, self._columns, self._columns - 2, self._rows - 2
        corners, shares = list[int](), list[float]()
        for x, y in zip(x_mm, y_mm, strict=True):
            u, v = x / dx - 0.5, y / dy - 0.5
            column, row = min(int(max(u, 0.0)), last_column), min(int(max(v, 0.0)), last_row)
            u, v, first = u - column, v - row, row * columns + column
            corners += (first, first + 1, first + columns, first + columns + 1)
            shares += ((1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v)
        four = self._nodes.take(np.array(corners, dtype=np.intp), axis=0).reshape(-1, 4, 6)
        found: list[list[float]] = np.matmul(np.array(shares).reshape(-1, 1, 4), four)[:, 0].tolist()
        for place in found:
            nx, ny, nz = place[3:]
            size = math.sqrt(nx * nx + ny * ny + nz * nz)
            place[3:] = (nx / size, ny / size, nz / size) if size > COLLAPSED else (0.0, 0.0, 0.0)
        return found


def _slope(points: Array, axis: int) -> Array:
    """Return the change from one point to the next along an axis, to second order up to the border."""
    return np.asarray(np.gradient(points, axis=axis, edge_order=2 if points.shape[axis] > 2 else 1))
