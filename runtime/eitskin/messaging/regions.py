"""Rectangles of pixels, and the topics by which subscribers say whether they need unchanged maps and touches.

The runtime always computes the whole map; a subscriber that needs a part of it slices it. Earlier releases computed
only the rectangles that subscribers asked for by topics such as ``eitskin/region/0/10/5/20``: the runtime accepts such
topics and sends whole maps, and recordings of those releases name the rectangles.
"""

import math
from dataclasses import dataclass
from typing import Final, Self

from eitskin.errors import MismatchError
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER

WHOLE: Final = b"eitskin/region/whole"
"""Topic by which a subscriber asks runtimes of earlier releases for the whole map."""

UNCHANGED: Final = b"eitskin/unchanged"
"""Topic of a subscriber that does without a map that has not changed."""

ALWAYS: Final = b"eitskin/always"
"""Topic of one that does not."""

TOUCHES: Final = b"eitskin/touches"
"""Topic of a subscriber that needs the list of touches in every frame."""

MAX_REGIONS: Final = 16
"""Regions that a message may name."""

MOST_PIXELS: Final = (120, 120)
"""Rows and columns of the largest map of a skin."""

EDGE_TOLERANCE_PX: Final = 1e-9
"""Of a pixel: a border that is meant to lie on a pixel's edge does not take the next pixel in by rounding."""


@dataclass(frozen=True, slots=True, order=True)
class Region:
    """A rectangle of pixels, upper bounds excluded."""

    first_row: int
    last_row: int
    first_column: int
    last_column: int

    def __post_init__(self) -> None:
        self.check(MOST_PIXELS)

    def check(self, shape: tuple[int, int]) -> Self:
        """Return this region, if it is one of a map.

        Args:
            shape: Rows and columns of the map.

        Raises:
            ValueError: It is not on the map, or has no area.
        """
        rows, columns = shape
        inside = 0 <= self.first_row < self.last_row <= rows and 0 <= self.first_column < self.last_column <= columns
        if not inside:
            raise ValueError(
                f"region rows {self.first_row} to {self.last_row}, columns {self.first_column} to {self.last_column} "
                f"is not on the sheet: rows are 0 to {rows}, columns 0 to {columns}, the upper bounds above the lower"
            )
        return self

    @classmethod
    def from_mm(cls, x0: float, y0: float, x1: float, y1: float, grid: Grid = PAPER.grid) -> Self:
        """Return the pixels that a rectangle on the flat sheet touches.

        Args:
            x0: Least x in mm.
            y0: Least y.
            x1: Largest x.
            y1: Largest y.
            grid: Of the skin.

        Raises:
            ValueError: It is not on the sheet, or has no area.
        """
        width, height = grid.size_mm
        if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
            raise ValueError(
                f"region x {x0:g} to {x1:g}, y {y0:g} to {y1:g} mm is not on the sheet: x is 0 to {width:g}, y 0 to "
                f"{height:g} mm, the upper bounds above the lower"
            )
        dx, dy = grid.pixel_mm
        rows = math.floor(y0 / dy + EDGE_TOLERANCE_PX), math.ceil(y1 / dy - EDGE_TOLERANCE_PX)
        columns = math.floor(x0 / dx + EDGE_TOLERANCE_PX), math.ceil(x1 / dx - EDGE_TOLERANCE_PX)
        return cls(*rows, *columns)

    @property
    def bounds(self) -> tuple[int, int, int, int]:
        """First and last row, first and last column."""
        return self.first_row, self.last_row, self.first_column, self.last_column

    @property
    def slices(self) -> tuple[slice, slice]:
        """Index into ``frame.map``."""
        return slice(self.first_row, self.last_row), slice(self.first_column, self.last_column)


EVERYWHERE: Final = Region(0, MOST_PIXELS[0], 0, MOST_PIXELS[1])
"""All pixels of any map."""

Regions = tuple[Region, ...]
"""The computed part of a map: the union of these; never empty."""


def whole(shape: tuple[int, int]) -> Regions:
    """Return the regions of a whole map."""
    return (Region(0, shape[0], 0, shape[1]),)


def other_skin(endpoint: str, shape: tuple[int, ...], grid: Grid) -> MismatchError:
    """Return the error for a region that would mean other pixels than intended, because the maps have another shape."""
    hint = "name the runtime's skin beside the region: --skin FILE, or subscribe(..., skin=...)"
    what = f"{endpoint}: rows and columns of the maps"
    return MismatchError(what, found=list(shape), expected=list(grid.shape), hint=hint)
