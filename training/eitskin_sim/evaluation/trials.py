"""Touches that nobody chose: phantoms drawn at deformations that no training has seen.

::

    single      one touch of a given size anywhere on the sheet: a hard square, or of any contrast, border and outline
    pair        two of them a given distance apart, edge to edge
    random      random units, or rectangles and discs anywhere, so many at a time
    untouched   the bent sheet alone, where no touch may appear

Deformations and touches come from seeds that no data set uses, and the voltages from the harness's own, finer mesh.
Phantoms of one deformation stand together.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from eitskin_proto.sensor.grid import N_UNITS, SHEET_MM, UNIT_SHAPE
from eitskin_sim.scene.family import Family, draw
from eitskin_sim.scene.parts import Bend, Phantom, Scene, Sheet, Touch
from eitskin_sim.scene.shapes import Disc, Rect, Shape
from eitskin_sim.scene.soft_touch import check_touch

SEED: Final = 30_011
"""Names the deformations and the touches of trials."""

PAIR_TOUCH_MM: Final = 10.0
"""Side of each touch of a pair."""

SIZES_MM: Final = (6.0, 22.0)
"""Sides and diameters of random touches anywhere."""

APART_MM: Final = 6.0
"""Random touches anywhere keep this distance between their boxes."""

Labels = Literal["units", "area"]
"""What the truth's pixels mean."""

Touches = Callable[[np.random.Generator], tuple[Touch, ...]]
"""Draws the touches of one phantom."""


@dataclass(frozen=True, slots=True)
class Softness:
    """What a trial's touch is besides its size: by default a hard square."""

    contrast: float = 50.0
    """Conductivity over the sheet's; below 1 where a press lowers it."""
    border_mm: float = 0.0
    """Width of its graded border."""
    disc: bool = False
    """Round, and not square."""


HARD: Final = Softness()


def single(
    size_mm: float, deformations: int, each: int, family: Family = "A", softness: Softness = HARD
) -> list[Phantom]:
    """Return phantoms of one touch each.

    Args:
        size_mm: Its side, or diameter.
        deformations: How many deformations.
        each: Touches at each, one at a time.
        family: Where the deformations are drawn from.
        softness: Its contrast, border and outline.

    Raises:
        ValueError: The touch does not fit on the sheet, would change nothing, or its border cannot be represented.
    """
    if not 2.0 <= size_mm <= min(SHEET_MM):
        raise ValueError(f"a touch of {size_mm:g} mm: its side must be from 2 to {min(SHEET_MM):g} mm")

    def touches(rng: np.random.Generator) -> tuple[Touch, ...]:
        x, y = rng.uniform((0.0, 0.0), (SHEET_MM[0] - size_mm, SHEET_MM[1] - size_mm))
        square = _square(float(x), float(y), size_mm)
        if softness == HARD:
            return (square,)
        radius = size_mm / 2
        shapes = (Disc(float(x) + radius, float(y) + radius, radius),) if softness.disc else square.shapes
        return (Touch(shapes, contrast=softness.contrast, border_mm=softness.border_mm),)

    check_touch(touches(np.random.default_rng(0))[0], Sheet(), "the trial's touch")
    return _phantoms(touches, deformations, each, family, "area")


def pair(gap_mm: float, deformations: int, each: int, family: Family = "A") -> list[Phantom]:
    """Return phantoms of two square touches of ``PAIR_TOUCH_MM``, side by side along x or y.

    Args:
        gap_mm: Their distance, edge to edge.
        deformations: How many deformations.
        each: Pairs at each, one at a time.
        family: Where the deformations are drawn from.

    Raises:
        ValueError: The pair does not fit on the sheet.
    """
    side, length = PAIR_TOUCH_MM, gap_mm + 2.0 * PAIR_TOUCH_MM
    if not (gap_mm > 0.0 and length <= SHEET_MM[0]):
        raise ValueError(f"a gap of {gap_mm:g} mm: it must be above 0 and at most {SHEET_MM[0] - 2 * side:g} mm")

    def touches(rng: np.random.Generator) -> tuple[Touch, ...]:
        along_y = length <= SHEET_MM[1] and bool(rng.random() < 0.5)
        step = (0.0, side + gap_mm) if along_y else (side + gap_mm, 0.0)
        x, y = rng.uniform((0.0, 0.0), (SHEET_MM[0] - side - step[0], SHEET_MM[1] - side - step[1]))
        return _square(float(x), float(y), side), _square(float(x + step[0]), float(y + step[1]), side)

    return _phantoms(touches, deformations, each, family, "area")


def random(counts: tuple[int, int], deformations: int, each: int, family: Family, labels: Labels) -> list[Phantom]:
    """Return phantoms of several random touches.

    Args:
        counts: Least and most touches.
        deformations: How many deformations.
        each: Touch sets at each.
        family: Where the deformations are drawn from.
        labels: "units" for units of the grid, "area" for rectangles and discs anywhere.

    Raises:
        ValueError: The counts are none, or the wrong way round.
    """
    if not 1 <= counts[0] <= counts[1] <= 12:
        raise ValueError(f"{counts[0]} to {counts[1]} touches: expected from 1 to 12, the smaller number first")

    def units(rng: np.random.Generator) -> tuple[Touch, ...]:
        chosen = rng.choice(N_UNITS, int(rng.integers(counts[0], counts[1] + 1)), replace=False)
        width, height = SHEET_MM[0] / UNIT_SHAPE[1], SHEET_MM[1] / UNIT_SHAPE[0]
        rows, columns = np.divmod(np.sort(chosen), UNIT_SHAPE[1])
        return tuple(
            Touch((Rect(c * width, r * height, (c + 1) * width, (r + 1) * height),))
            for r, c in zip(rows.tolist(), columns.tolist(), strict=True)
        )

    def anywhere(rng: np.random.Generator) -> tuple[Touch, ...]:
        wanted = int(rng.integers(counts[0], counts[1] + 1))
        shapes: list[Shape] = []
        while len(shapes) < wanted:
            shape = _shape(rng)
            if all(_apart(shape, other) for other in shapes):
                shapes.append(shape)
        return tuple(Touch((shape,)) for shape in shapes)

    return _phantoms(units if labels == "units" else anywhere, deformations, each, family, labels)


def untouched(deformations: int, family: Family = "A", labels: Labels = "area") -> list[Phantom]:
    """Return bent sheets that nothing touches, one a deformation."""
    return _phantoms(lambda rng: (), deformations, 1, family, labels)


def deformations_of(count: int, family: Family) -> tuple[Bend, ...]:
    """Return the deformations of the trials."""
    if count < 1:
        raise ValueError(f"{count} deformations: expected at least 1")
    return draw(family, count, SEED)


def _phantoms(touches: Touches, deformations: int, each: int, family: Family, labels: Labels) -> list[Phantom]:
    if each < 1:
        raise ValueError(f"{each} touch sets at each deformation: expected at least 1")
    found = []
    for number, bend in enumerate(deformations_of(deformations, family)):
        rng = np.random.default_rng([SEED, ord(family), number])
        for index in range(each):
            scene = Scene(bend=bend, touches=touches(rng))
            found.append(Phantom(f"{family}{number}.{index}", scene, labels))
    return found


def _square(x_mm: float, y_mm: float, size_mm: float) -> Touch:
    return Touch((Rect(x_mm, y_mm, x_mm + size_mm, y_mm + size_mm),))


def _shape(rng: np.random.Generator) -> Shape:
    width, height = rng.uniform(*SIZES_MM, 2)
    if rng.random() < 0.5:
        radius = float(width) / 2
        x, y = rng.uniform((radius, radius), (SHEET_MM[0] - radius, SHEET_MM[1] - radius))
        return Disc(float(x), float(y), radius)
    x, y = rng.uniform((0.0, 0.0), (SHEET_MM[0] - width, SHEET_MM[1] - height))
    return Rect(float(x), float(y), float(x + width), float(y + height))


def _apart(first: Shape, second: Shape) -> bool:
    a, b = first.bounds_mm, second.bounds_mm
    gaps = (max(a[0], b[0]) - min(a[2], b[2]), max(a[1], b[1]) - min(a[3], b[3]))
    return max(gaps) >= APART_MM
