"""What subscribers ask for: regions of the sheet, so that only their union is computed, and maps only when they change.

A subscriber declares its rectangle by a topic of its own, ``eitskin/region/0/10/5/20``: rows 0 to 9 and columns 5 to 19
of the map. ZeroMQ tells the publisher of topics that come and go, so a subscriber that dies takes its region along. Who
needs the whole map, whatever its size, says ``eitskin/region/whole``.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from eitskin.errors import MismatchError
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER

TOPIC: Final = re.compile(rb"eitskin/region/(\d{1,3})/(\d{1,3})/(\d{1,3})/(\d{1,3})")

WHOLE: Final = b"eitskin/region/whole"
"""Topic of a subscriber that needs the whole map."""

UNCHANGED: Final = b"eitskin/unchanged"
"""Topic of a subscriber that does without a map that has not changed."""

ALWAYS: Final = b"eitskin/always"
"""Topic of one that does not."""

TOUCHES: Final = b"eitskin/touches"
"""Topic of a subscriber that needs the list of touches in every frame."""

MOST: Final = 16
"""Regions of different subscribers at once; with more, the whole sheet is computed."""

MOST_PIXELS: Final = (120, 120)
"""Rows and columns of the largest map of a skin."""

SLACK: Final = 1e-9
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
        rows = math.floor(y0 / dy + SLACK), math.ceil(y1 / dy - SLACK)
        columns = math.floor(x0 / dx + SLACK), math.ceil(x1 / dx - SLACK)
        return cls(*rows, *columns)

    @classmethod
    def from_topic(cls, topic: bytes, shape: tuple[int, int]) -> Self | None:
        """Return the region of a map that a topic declares; None if it declares none that is on it.

        Args:
            topic: Of a subscriber.
            shape: Rows and columns of the map.
        """
        if topic == WHOLE:
            return cls(0, shape[0], 0, shape[1])
        match = TOPIC.fullmatch(topic)
        try:
            return None if match is None else cls(*map(int, match.groups())).check(shape)
        except ValueError:
            return None

    @property
    def topic(self) -> bytes:
        """What a subscriber of this region subscribes to."""
        return b"eitskin/region/%d/%d/%d/%d" % self.bounds

    @property
    def bounds(self) -> tuple[int, int, int, int]:
        """First and last row, first and last column."""
        return self.first_row, self.last_row, self.first_column, self.last_column

    @property
    def slices(self) -> tuple[slice, slice]:
        """What ``frame.map`` is indexed with."""
        return slice(self.first_row, self.last_row), slice(self.first_column, self.last_column)


EVERYWHERE: Final = Region(0, MOST_PIXELS[0], 0, MOST_PIXELS[1])
"""All pixels of any map."""

Regions = tuple[Region, ...]
"""What is computed: the union of these; never empty."""


def whole(shape: tuple[int, int]) -> Regions:
    """Return what is computed of a map of all rows and columns."""
    return (Region(0, shape[0], 0, shape[1]),)


def union(regions: Iterable[Region], shape: tuple[int, int]) -> Regions:
    """Return what must be computed for all of them: sorted, none twice; the whole map for none or too many.

    Args:
        regions: Any number.
        shape: Rows and columns of the map.
    """
    found, every = sorted(set(regions)), whole(shape)
    return every if not found or every[0] in found or len(found) > MOST else tuple(found)


def pixels(regions: Regions, shape: tuple[int, int]) -> npt.NDArray[np.intp]:
    """Return (n,) the flat indices of the union's pixels in a map of these rows and columns, ascending."""
    wanted = np.zeros(shape, dtype=bool)
    for region in regions:
        wanted[region.slices] = True
    return np.flatnonzero(wanted)


def other_skin(endpoint: str, shape: tuple[int, ...], grid: Grid) -> MismatchError:
    """Return what is raised where a region means other pixels than were meant: the maps have another shape."""
    hint = "name the runtime's skin beside the region: --skin FILE, or subscribe(..., skin=...)"
    what = f"{endpoint}: rows and columns of the maps"
    return MismatchError(what, found=list(shape), expected=list(grid.shape), hint=hint)
