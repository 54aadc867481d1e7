"""Where things are on the flat sheet: the 30 x 45 map, the 9 x 14 units, the 16 electrodes.

The frame has x along 150 mm, y along 100 mm, and its origin at a corner. Everything is stored row by row from there::

        y = 100 +----------------------------+     map[row, column]: row along y, column along x
                |                            |     pixel centre = ((column + 1/2) * 10/3, (row + 1/2) * 10/3) mm
                |                            |     unit (column, row) of 14 x 9 has index row * 14 + column
          y = 0 +----------------------------+     electrodes by arc length, counter-clockwise from (0, 0)
              x = 0                      x = 150
"""

from typing import Final

import numpy as np
import numpy.typing as npt

SHEET_MM: Final = (150.0, 100.0)
"""Length along x and width along y of the conductive sheet (paper section III)."""

GRID_SHAPE: Final = (30, 45)
"""Rows and columns of the map: the paper's 1350 values with square pixels."""

N_PIXELS: Final = GRID_SHAPE[0] * GRID_SHAPE[1]
"""1350 values in a map (paper section IV.C)."""

QUARTER_SHAPE: Final = ((GRID_SHAPE[0] + 1) // 2, (GRID_SHAPE[1] + 1) // 2)
"""(15, 23) pixels whose four mirror images are the map; the middle column is its own image in x."""

PITCH_MM: Final = SHEET_MM[0] / GRID_SHAPE[1]
"""Side of a pixel."""

UNIT_SHAPE: Final = (9, 14)
"""Rows and columns of touch units (paper section V.A)."""

N_UNITS: Final = UNIT_SHAPE[0] * UNIT_SHAPE[1]
"""126 touch units."""

ELECTRODE_ARC_MM: Final[npt.NDArray[np.float64]] = 12.5 + 31.25 * np.arange(16, dtype=np.float64)
"""(16,) arc length of each electrode's centre from the corner (0, 0), counter-clockwise: even and mirror-symmetric."""
ELECTRODE_ARC_MM.setflags(write=False)


def pixel_centres_mm() -> npt.NDArray[np.float64]:
    """Return the (30, 45, 2) x and y of every pixel's centre."""
    rows, columns = np.indices(GRID_SHAPE)
    return np.stack([(columns + 0.5) * PITCH_MM, (rows + 0.5) * PITCH_MM], axis=-1)


def unit_rect_mm(column: int, row: int) -> tuple[float, float, float, float]:
    """Return the border (x0, y0, x1, y1) of a touch unit.

    Raises:
        ValueError: The unit is not one of the 14 x 9.
    """
    if not (0 <= column < UNIT_SHAPE[1] and 0 <= row < UNIT_SHAPE[0]):
        raise ValueError(
            f"unit [{column}, {row}] is not on the sheet: "
            f"columns are 0 to {UNIT_SHAPE[1] - 1}, rows 0 to {UNIT_SHAPE[0] - 1}"
        )
    width, height = SHEET_MM[0] / UNIT_SHAPE[1], SHEET_MM[1] / UNIT_SHAPE[0]
    return column * width, row * height, (column + 1) * width, (row + 1) * height


def _unit_of_pixel() -> npt.NDArray[np.intp]:
    centres = pixel_centres_mm()
    column = np.floor(centres[..., 0] * UNIT_SHAPE[1] / SHEET_MM[0]).astype(np.intp)
    row = np.floor(centres[..., 1] * UNIT_SHAPE[0] / SHEET_MM[1]).astype(np.intp)
    return row * UNIT_SHAPE[1] + column


UNIT_OF_PIXEL: Final[npt.NDArray[np.intp]] = _unit_of_pixel()
"""(30, 45) the unit in which each pixel's centre lies; a unit has 9, 12 or 16 pixels."""
UNIT_OF_PIXEL.setflags(write=False)


def map_from_units(units: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    """Return (..., 30, 45) maps from (..., 126) values a unit: the hard labels of the paper, without loss."""
    return units[..., UNIT_OF_PIXEL]
