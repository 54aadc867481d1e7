"""The map of a skin: its pixels and touch units on the flat sheet.

x runs along the sheet's length, y along its width, from a corner. Arrays are stored row by row::

    y = width +----------------------------+     map[row, column]: row along y, column along x
              |                            |     pixel centre = ((column + 1/2) dx, (row + 1/2) dy)
              |                            |     unit (column, row) has index row * columns + column
        y = 0 +----------------------------+
            x = 0                     x = length

A disc has the map of the square about it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Grid:
    """Pixels and touch units of a rectangle."""

    size_mm: tuple[float, float]
    """Length along x and width along y."""
    shape: tuple[int, int]
    """Rows and columns of pixels."""
    units: tuple[int, int]
    """Rows and columns of touch units."""

    @property
    def n_pixels(self) -> int:
        """Number of pixels of a map."""
        return self.shape[0] * self.shape[1]

    @property
    def n_units(self) -> int:
        """Number of touch units."""
        return self.units[0] * self.units[1]

    @property
    def pixel_mm(self) -> tuple[float, float]:
        """Length along x and width along y of a pixel, in mm."""
        return self.size_mm[0] / self.shape[1], self.size_mm[1] / self.shape[0]

    @property
    def pitch_mm(self) -> float:
        """Side of a square with a pixel's area, in mm."""
        dx, dy = self.pixel_mm
        return dx if dx == dy else float(np.sqrt(dx * dy))

    @property
    def pixel_mm2(self) -> float:
        """Area of a pixel in mm2."""
        return self.pixel_mm[0] * self.pixel_mm[1]

    @property
    def quarter(self) -> tuple[int, int]:
        """Rows and columns of the quarter that gives the map by mirroring in x and y; it includes a middle line."""
        return (self.shape[0] + 1) // 2, (self.shape[1] + 1) // 2

    @property
    def cloud_shape(self) -> tuple[int, int, int]:
        """Shape of a cloud: (3, rows, columns)."""
        return 3, *self.shape

    def pixel_centres_mm(self) -> npt.NDArray[np.float64]:
        """Return x and y of every pixel's centre in mm, (rows, columns, 2)."""
        rows, columns = np.indices(self.shape)
        dx, dy = self.pixel_mm
        return np.stack([(columns + 0.5) * dx, (rows + 0.5) * dy], axis=-1)

    def flat_cloud_mm(self) -> npt.NDArray[np.float64]:
        """Return the (3, rows, columns) cloud of the flat sheet: pixel centres with z = 0."""
        centres = self.pixel_centres_mm()
        return np.stack([centres[..., 0], centres[..., 1], np.zeros(self.shape)])

    def unit_rect_mm(self, column: int, row: int) -> tuple[float, float, float, float]:
        """Return the border (x0, y0, x1, y1) of a touch unit in mm.

        Raises:
            ValueError: There is no such unit.
        """
        rows, columns = self.units
        if not (0 <= column < columns and 0 <= row < rows):
            raise ValueError(
                f"unit [{column}, {row}] is not on the sheet: columns are 0 to {columns - 1}, rows 0 to {rows - 1}"
            )
        width, height = self.size_mm[0] / columns, self.size_mm[1] / rows
        return column * width, row * height, (column + 1) * width, (row + 1) * height

    @cached_property
    def unit_of_pixel(self) -> npt.NDArray[np.intp]:
        """(rows, columns), the number of the unit at each pixel's centre."""
        centres = self.pixel_centres_mm()
        column = np.floor(centres[..., 0] * self.units[1] / self.size_mm[0]).astype(np.intp)
        row = np.floor(centres[..., 1] * self.units[0] / self.size_mm[1]).astype(np.intp)
        found = row * self.units[1] + column
        found.setflags(write=False)
        return np.asarray(found)

    def map_from_units(self, units: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        """Return (..., rows, columns) maps from (..., n_units) values of the units."""
        return units[..., self.unit_of_pixel]
