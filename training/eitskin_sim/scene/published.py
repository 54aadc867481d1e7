"""The eight published phantoms (paper section V.C), by content, so that no training set can hold one.

A network must not be trained on the phantoms that judge it. Every generator of touch sets checks its draws here. A test
compares this table with the phantom files themselves.
"""

from collections.abc import Iterable
from typing import Final

from eitskin_proto.skin.skin import PAPER

Rect = tuple[float, float, float, float]
"""x0, y0, x1, y1 in mm on the flat sheet."""

PHANTOM_UNITS: Final[dict[str, tuple[tuple[int, int], ...]]] = {
    "1": ((2, 2), (11, 2), (7, 4), (2, 6), (11, 6)),
    "2": ((4, 4), (5, 4), (6, 4), (7, 4), (8, 4), (9, 4)),
    "3": ((4, 3), (4, 4), (4, 5), (4, 6), (5, 3), (6, 3)),
    "4": ((3, 2), (10, 2), (7, 6), (1, 5), (12, 5)),
    "5": ((3, 6), (4, 6), (8, 3), (8, 4), (8, 5), (9, 3), (9, 4), (9, 5)),
    "6": ((8, 4), (8, 5), (8, 6), (9, 4), (10, 4)),
    "7": ((2, 2), (3, 2), (4, 2), (9, 5), (9, 6), (10, 5), (10, 6)),
    "8": ((2, 2), (7, 2), (11, 2), (2, 6), (7, 6), (11, 6)),
}
"""The touched units (column, row) of each phantom on the unit grid."""

PHANTOM_RECTS_MM: Final[dict[str, tuple[Rect, ...]]] = {
    "1": ((20, 20, 30, 30), (120, 20, 130, 30), (70, 45, 80, 55), (20, 70, 30, 80), (120, 70, 130, 80)),
    "2": ((45, 45, 105, 55),),
    "3": ((40, 30, 50, 70), (50, 30, 70, 40)),
    "4": ((35, 25, 45, 35), (105, 25, 115, 35), (70, 65, 80, 75), (15, 55, 25, 65), (125, 60, 135, 70)),
    "5": ((30, 60, 50, 70), (90, 30, 110, 60)),
    "6": ((90, 40, 100, 70), (100, 40, 120, 50)),
    "7": ((25, 25, 55, 35), (95, 55, 115, 75)),
    "8": (
        (20, 25, 30, 35),
        (70, 20, 80, 30),
        (120, 25, 130, 35),
        (20, 65, 30, 75),
        (70, 70, 80, 80),
        (120, 65, 130, 75),
    ),
}
"""The touched rectangles of each phantom in true millimetres."""

_PUBLISHED_UNITS: Final = frozenset(
    frozenset(row * PAPER.grid.units[1] + column for column, row in units) for units in PHANTOM_UNITS.values()
)


def is_published(units: Iterable[int], shape: tuple[int, int] = PAPER.grid.units) -> bool:
    """Return whether a set of unit numbers (row * columns + column) is one of the published phantoms.

    Args:
        units: Numbers of the touched units.
        shape: Rows and columns of the units; phantoms were published for the paper's alone.
    """
    return shape == PAPER.grid.units and frozenset(units) in _PUBLISHED_UNITS
