"""What subscribers ask for: regions of the sheet, so that only their union is computed, and maps only when they change.

A subscriber declares its rectangle by a topic of its own, ``eitskin/region/0/10/5/20``: rows 0 to 9 and columns 5 to 19
of the map. ZeroMQ tells the publisher of topics that come and go, so a subscriber that dies takes its region along.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.grid import GRID_SHAPE, PITCH_MM, SHEET_MM

TOPIC: Final = re.compile(rb"eitskin/region/(\d{1,2})/(\d{1,2})/(\d{1,2})/(\d{1,2})")

UNCHANGED: Final = b"eitskin/unchanged"
"""Topic of a subscriber that does without a map that has not changed."""

ALWAYS: Final = b"eitskin/always"
"""Topic of one that does not."""

MOST: Final = 16
"""Regions of different subscribers at once; with more, the whole sheet is computed."""

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
        rows, columns = GRID_SHAPE
        inside = 0 <= self.first_row < self.last_row <= rows and 0 <= self.first_column < self.last_column <= columns
        if not inside:
            raise ValueError(
                f"region rows {self.first_row} to {self.last_row}, columns {self.first_column} to {self.last_column} "
                f"is not on the sheet: rows are 0 to {rows}, columns 0 to {columns}, the upper bounds above the lower"
            )

    @classmethod
    def from_mm(cls, x0: float, y0: float, x1: float, y1: float) -> Self:
        """Return the pixels that a rectangle on the flat sheet touches.

        Raises:
            ValueError: It is not on the sheet, or has no area.
        """
        width, height = SHEET_MM
        if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
            raise ValueError(
                f"region x {x0:g} to {x1:g}, y {y0:g} to {y1:g} mm is not on the sheet: x is 0 to {width:g}, y 0 to "
                f"{height:g} mm, the upper bounds above the lower"
            )
        rows = math.floor(y0 / PITCH_MM + SLACK), math.ceil(y1 / PITCH_MM - SLACK)
        columns = math.floor(x0 / PITCH_MM + SLACK), math.ceil(x1 / PITCH_MM - SLACK)
        return cls(*rows, *columns)

    @classmethod
    def from_topic(cls, topic: bytes) -> Self | None:
        """Return the region that a topic declares; None if it declares none that is on the sheet."""
        match = TOPIC.fullmatch(topic)
        try:
            return None if match is None else cls(*map(int, match.groups()))
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


WHOLE: Final = Region(0, GRID_SHAPE[0], 0, GRID_SHAPE[1])

Regions = tuple[Region, ...]
"""What is computed: the union of these; never empty."""


def union(regions: Iterable[Region]) -> Regions:
    """Return what must be computed for all of them: sorted, none twice; the whole sheet for none or too many."""
    found = sorted(set(regions))
    return (WHOLE,) if not found or WHOLE in found or len(found) > MOST else tuple(found)


def pixels(regions: Regions) -> npt.NDArray[np.intp]:
    """Return (n,) the flat indices of the union's pixels, ascending."""
    wanted = np.zeros(GRID_SHAPE, dtype=bool)
    for region in regions:
        wanted[region.slices] = True
    return np.flatnonzero(wanted)
