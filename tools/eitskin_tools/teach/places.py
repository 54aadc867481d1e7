"""Where to press: a grid of places on a sheet, printed at its true size, and drawn with the next place marked."""

import string
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import numpy as np

ORDER_SEED: Final = 0
"""Places come in no order, so that what drifts in time is not mistaken for what changes with place."""


@dataclass(frozen=True, slots=True)
class Place:
    """A place to press."""

    name: str
    """Row and column of the printed grid: ``C4``."""
    x_mm: float
    y_mm: float

    def __str__(self) -> str:
        return f"{self.name} ({self.x_mm:g}, {self.y_mm:g}) mm" if self.name else f"({self.x_mm:g}, {self.y_mm:g}) mm"


def grid_places(size_mm: tuple[float, float], outline: str, count: int) -> list[Place]:
    """Return about as many places as wanted, on a square grid in the outline, in the order of presses.

    Args:
        size_mm: Length and width of the sheet; twice the diameter of a disc.
        outline: ``rectangle`` or ``disc``.
        count: How many are wanted.
    """
    length, width = size_mm
    disc = outline == "disc"
    pitch = float(np.sqrt((np.pi / 4.0 if disc else 1.0) * length * width / count))
    columns, rows = max(round(length / pitch), 1), max(round(width / pitch), 1)
    found = []
    for row in range(rows):
        for column in range(columns):
            x, y = length * (column + 0.5) / columns, width * (row + 0.5) / rows
            if disc and np.hypot(x - length / 2, y - width / 2) > length / 2 - pitch / 3:
                continue
            name = f"{string.ascii_uppercase[row % 26]}{column + 1}"
            found.append(Place(name, round(x, 1), round(y, 1)))
    return [found[k] for k in np.random.default_rng(ORDER_SEED).permutation(len(found))]


def draw_grid(
    size_mm: tuple[float, float], outline: str, places: Collection[Place], done: Collection[Place] = (),
    following: Place | None = None,
) -> str:  # fmt: skip
    """Return an SVG of the sheet at its true size, seen with x to the right and y upwards.

    Args:
        size_mm: Of the sheet.
        outline: ``rectangle`` or ``disc``.
        places: All places.
        done: Those that were pressed.
        following: The one to press next.
    """
    length, width = size_mm
    border = (
        f'<ellipse cx="{length / 2:g}" cy="{width / 2:g}" rx="{length / 2:g}" ry="{width / 2:g}"'
        if outline == "disc"
        else f'<rect width="{length:g}" height="{width:g}"'
    )
    marks = []
    for place in places:
        x, y = place.x_mm, width - place.y_mm
        if place == following:
            marks.append(f'<circle cx="{x:g}" cy="{y:g}" r="5" fill="#d33"/>')
        elif place in done:
            marks.append(f'<circle cx="{x:g}" cy="{y:g}" r="2" fill="#3a3"/>')
        marks.append(f'<path d="M{x - 2:g} {y:g}h4M{x:g} {y - 2:g}v4" stroke="#888" stroke-width=".3"/>')
        marks.append(f'<text x="{x + 1:g}" y="{y - 1:g}" font-size="3" font-family="sans-serif">{place.name}</text>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{length + 2:g}mm" height="{width + 2:g}mm" '
        f'viewBox="-1 -1 {length + 2:g} {width + 2:g}">'
        f'{border} fill="#fff" stroke="#000" stroke-width=".3"/>{"".join(marks)}</svg>\n'
    )
