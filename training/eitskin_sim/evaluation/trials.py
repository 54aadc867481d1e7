"""Random phantoms at deformations that no training has seen.

::

    single      one touch of a given size anywhere on the sheet: a hard square, or of any contrast, border and outline
    pair        two of them a given distance apart, edge to edge
    random      random units, or rectangles and discs anywhere, a given number at a time
    untouched   the bent sheet alone, where no touch may appear

Deformations and touches come from seeds that no data set uses, and the voltages from the harness's own, finer mesh.
Phantoms of one deformation are consecutive.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.scene.family import Family, draw
from eitskin_sim.scene.nominal import nominal_scene, nominal_sheet
from eitskin_sim.scene.parts import Bend, Phantom, Touch
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

TRIES: Final = 1000
"""Draws in a row without a place, after which a set of touches anywhere is restarted."""

STARTS: Final = 20
"""Restarts after which the sheet counts as too small for this number."""

Labels = Literal["units", "area"]
"""What the truth's pixels mean."""

Touches = Callable[[np.random.Generator], tuple[Touch, ...]]
"""Draws the touches of one phantom."""


@dataclass(frozen=True, slots=True)
class TouchProfile:
    """A trial's touch apart from its size: by default a hard square."""

    contrast: float = 50.0
    """Conductivity over the sheet's; below 1 where a press lowers it."""
    border_mm: float = 0.0
    """Width of its graded border."""
    disc: bool = False
    """Round, and not square."""


HARD_SQUARE: Final = TouchProfile()


def single(
    size_mm: float,
    deformations: int,
    each: int,
    family: Family = "A",
    softness: TouchProfile = HARD_SQUARE,
    skin: Skin = PAPER,
    seed: int = 0,
) -> list[Phantom]:
    """Return phantoms of one touch each.

    Args:
        size_mm: Its side, or diameter.
        deformations: How many deformations.
        each: Touches at each, one at a time.
        family: Where the deformations are drawn from.
        softness: Its contrast, border and outline.
        skin: What is touched.
        seed: Which draw of deformations and touches.

    Raises:
        ValueError: The touch does not fit on the sheet, would change nothing, or its border cannot be represented.
    """
    length, width = skin.grid.size_mm
    if not 2.0 <= size_mm <= min(length, width):
        raise ValueError(f"a touch of {size_mm:g} mm: its side must be from 2 to {min(length, width):g} mm")

    def touches(rng: np.random.Generator) -> tuple[Touch, ...]:
        x, y = rng.uniform((0.0, 0.0), (length - size_mm, width - size_mm))
        square = _square(float(x), float(y), size_mm)
        if softness == HARD_SQUARE:
            return (square,)
        radius = size_mm / 2
        shapes = (Disc(float(x) + radius, float(y) + radius, radius),) if softness.disc else square.shapes
        return (Touch(shapes, contrast=softness.contrast, border_mm=softness.border_mm),)

    check_touch(touches(np.random.default_rng(0))[0], nominal_sheet(skin), "the trial's touch")
    return _phantoms(touches, deformations, each, family, "area", skin, seed)


def pair(
    gap_mm: float,
    deformations: int,
    each: int,
    family: Family = "A",
    skin: Skin = PAPER,
    seed: int = 0,
    side_mm: float = PAIR_TOUCH_MM,
) -> list[Phantom]:
    """Return phantoms of two square touches, side by side along x or y.

    Args:
        gap_mm: Their distance, edge to edge.
        deformations: How many deformations.
        each: Pairs at each, one at a time.
        family: Where the deformations are drawn from.
        skin: What is touched.
        seed: Which draw of deformations and touches.
        side_mm: Of each touch.

    Raises:
        ValueError: The pair does not fit on the sheet.
    """
    side, length = side_mm, gap_mm + 2.0 * side_mm
    along, across = skin.grid.size_mm
    if not (gap_mm > 0.0 and length <= along):
        raise ValueError(f"a gap of {gap_mm:g} mm: it must be above 0 and at most {along - 2 * side:g} mm")

    def touches(rng: np.random.Generator) -> tuple[Touch, ...]:
        along_y = length <= across and bool(rng.random() < 0.5)
        step = (0.0, side + gap_mm) if along_y else (side + gap_mm, 0.0)
        x, y = rng.uniform((0.0, 0.0), (along - side - step[0], across - side - step[1]))
        return _square(float(x), float(y), side), _square(float(x + step[0]), float(y + step[1]), side)

    return _phantoms(touches, deformations, each, family, "area", skin, seed)


def random(
    counts: tuple[int, int],
    deformations: int,
    each: int,
    family: Family,
    labels: Labels,
    skin: Skin = PAPER,
    seed: int = 0,
) -> list[Phantom]:
    """Return phantoms of several random touches.

    Args:
        counts: Least and most touches.
        deformations: How many deformations.
        each: Touch sets at each.
        family: Where the deformations are drawn from.
        labels: "units" for units of the grid, "area" for rectangles and discs anywhere.
        skin: What is touched.
        seed: Which draw of deformations and touches.

    Raises:
        ValueError: The counts are none, or the wrong way round, or the sheet has no room for this number.
    """
    if not 1 <= counts[0] <= counts[1] <= 12:
        raise ValueError(f"{counts[0]} to {counts[1]} touches: expected from 1 to 12, the smaller number first")
    if labels == "units" and counts[1] > skin.grid.n_units:
        most = skin.grid.n_units
        raise ValueError(f"{counts[0]} to {counts[1]} touches on {most} units; ask for at most {most}")

    def units(rng: np.random.Generator) -> tuple[Touch, ...]:
        grid = skin.grid
        chosen = rng.choice(grid.n_units, int(rng.integers(counts[0], counts[1] + 1)), replace=False)
        rows, columns = np.divmod(np.sort(chosen), grid.units[1])
        return tuple(
            Touch((Rect(*grid.unit_rect_mm(column, row)),))
            for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        )

    def anywhere(rng: np.random.Generator) -> tuple[Touch, ...]:
        wanted = int(rng.integers(counts[0], counts[1] + 1))
        for _ in range(STARTS):
            shapes = _drawn(wanted, rng, skin.grid)
            if len(shapes) == wanted:
                return tuple(Touch((shape,)) for shape in shapes)
        along, across = skin.grid.size_mm
        raise ValueError(
            f"{wanted} touches of {SIZES_MM[0]:g} to {SIZES_MM[1]:g} mm, {APART_MM:g} mm apart, do not fit on a "
            f"sheet of {along:g} x {across:g} mm; ask for fewer"
        )

    return _phantoms(units if labels == "units" else anywhere, deformations, each, family, labels, skin, seed)


def untouched(
    deformations: int, family: Family = "A", labels: Labels = "area", skin: Skin = PAPER, seed: int = 0
) -> list[Phantom]:
    """Return bent sheets that nothing touches, one a deformation."""
    return _phantoms(lambda rng: (), deformations, 1, family, labels, skin, seed)


def deformations_of(count: int, family: Family, skin: Skin = PAPER, seed: int = 0) -> tuple[Bend, ...]:
    """Return the deformations of the trials."""
    if count < 1:
        raise ValueError(f"{count} deformations: expected at least 1")
    return draw(family, count, SEED + seed, skin)


def _phantoms(
    touches: Touches, deformations: int, each: int, family: Family, labels: Labels, skin: Skin, seed: int
) -> list[Phantom]:
    if each < 1:
        raise ValueError(f"{each} touch sets at each deformation: expected at least 1")
    found = []
    for number, bend in enumerate(deformations_of(deformations, family, skin, seed)):
        rng = np.random.default_rng([SEED + seed, ord(family), number])
        for index in range(each):
            scene = nominal_scene(skin, bend, touches(rng))
            found.append(Phantom(f"{family}{number}.{index}", scene, labels))
    return found


def _square(x_mm: float, y_mm: float, size_mm: float) -> Touch:
    return Touch((Rect(x_mm, y_mm, x_mm + size_mm, y_mm + size_mm),))


def _drawn(wanted: int, rng: np.random.Generator, grid: Grid) -> list[Shape]:
    """Return shapes that are apart, the given number or as many as there is room for."""
    shapes: list[Shape] = []
    tries = 0
    while len(shapes) < wanted and tries < TRIES:
        shape = _shape(rng, grid)
        tries += 1
        if all(_apart(shape, other) for other in shapes):
            shapes.append(shape)
            tries = 0
    return shapes


def _shape(rng: np.random.Generator, grid: Grid) -> Shape:
    along, across = grid.size_mm
    width, height = rng.uniform(*SIZES_MM, 2)
    if rng.random() < 0.5:
        radius = float(width) / 2
        x, y = rng.uniform((radius, radius), (along - radius, across - radius))
        return Disc(float(x), float(y), radius)
    x, y = rng.uniform((0.0, 0.0), (along - width, across - height))
    return Rect(float(x), float(y), float(x + width), float(y + height))


def _apart(first: Shape, second: Shape) -> bool:
    a, b = first.bounds_mm, second.bounds_mm
    gaps = (max(a[0], b[0]) - min(a[2], b[2]), max(a[1], b[1]) - min(a[3], b[3]))
    return max(gaps) >= APART_MM
