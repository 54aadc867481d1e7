"""The surface under a map: where a place of the flat sheet lies in space, which way it faces, and how it is stretched.

The cloud's points lie under the pixels' centres. Between four of them the surface is bilinear, and so are the
directions in which it faces at the points; beyond the outermost points, half a pixel, it goes on straight. It faces the
way in which the flat sheet faces z: along the direction of x times that of y. The pose is the cloud's own.
"""

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

    __slots__ = ("_columns", "_corners", "_nodes", "_pixel_mm", "_rows", "stretch")

    def __init__(self, cloud_mm: npt.NDArray[np.floating], grid: Grid) -> None:
        self._rows, self._columns = grid.shape
        corners = [[0], [self._columns], [1], [self._columns + 1]]
        self._corners = np.array(corners, dtype=np.intp)
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

    def at(self, x_mm: Array, y_mm: Array) -> Array:
        """Return (n, 6): the places in space in mm, and the unit vectors in which the surface faces there.

        A direction is (0, 0, 0) where the surface has none.

        Args:
            x_mm: (n,) on the flat sheet.
            y_mm: (n,) the same.
        """
        u, v = x_mm / self._pixel_mm[0] - 0.5, y_mm / self._pixel_mm[1] - 0.5
        column = np.minimum(np.maximum(u, 0.0).astype(np.intp), self._columns - 2)
        row = np.minimum(np.maximum(v, 0.0).astype(np.intp), self._rows - 2)
        u -= column
        v -= row
        first = row * self._columns + column
        right, below = u[:, np.newaxis], v[:, np.newaxis]
        four = self._nodes.take(first + self._corners, axis=0)
        upper, lower = four[:2] + right * (four[2:] - four[:2])
        found = upper + below * (lower - upper)
        faces = found[:, 3:]
        size = np.sqrt((faces * faces).sum(axis=1))
        faces /= np.where(size > COLLAPSED, size, np.inf)[:, np.newaxis]
        return np.asarray(found)


def _slope(points: Array, axis: int) -> Array:
    """Return the change from one point to the next along an axis, to second order up to the border."""
    return np.asarray(np.gradient(points, axis=axis, edge_order=2 if points.shape[axis] > 2 else 1))
