"""Random touches off the unit grid, and pools of them: the touches that a data set draws, by name or from the skin.

::

    hard     the paper's, contrast 20 to 200, sharp: half of them are turned by any angle
                 rectangle  5 to 25 mm each way        bar  5 to 14 mm by 25 to 80 mm
                 disc       5 to 25 mm across          L    two arms of 12 to 45 mm, 5 to 14 mm wide
    press    all lower conductance, contrast 0.2 to 0.85, by strength as below
    raise    all raise it, contrast 1.2 to 200 log-uniform: half of them any size from 8 to 25 mm with borders as
             below, half of the sharp shapes of hard touches, bars and L's among them
    firm     as raise, contrast 5 to 200, borders of up to 4 mm: good conductors on a sheet of a lab
    both     half of the touches lower it so; a quarter raises it, contrast 1.2 to 200 log-uniform, any size from 8 to
             25 mm; a quarter has that contrast and the sharp shapes of hard touches, bars and L's among them
    skin     the ways, contrasts, sizes and borders of the skin's description; where its sizes are from 5 to 25 mm or
             more, half of those that raise have the sharp shapes of hard touches, as above

Measured presses of hydrogel skins by a 5 mm probe, 10 / 15 / 20 mm deep, take 99 / 176 / 269 mm^2 of conductance away
(change over the sheet's conductivity, times area; as depth^1.45, quartiles 1.2 to 1.4 apart), and change voltages by
0.7 to 1.8 % (median row). So a press is drawn by its contrast and its strength: depth is uniform from 5 to 22 mm,
strength follows it with that spread, and size follows from both; one outside 8 to 25 mm is drawn again. A quarter of
the borders of presses is sharp, the others are graded over 0.5 to 8 mm, at most over the press's width. Where no
measured strength goes with the skin's contrasts and sizes, sizes are drawn by themselves.

A pool holds touches of ``CLASSES`` conductivities, one after the other: a set whose touches share one takes them from
one class (:mod:`eitskin_sim.freeform.draws`).
"""

from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin import touch_kind as ways
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.scene.gap import half_extents_mm
from eitskin_sim.scene.soft_touch import MIN_BORDER_MM
from eitskin_sim.scene.touch_table import DISC, ELLIPSE, RECTANGLE, TouchTable, gather

TouchKind = Literal["hard", "firm", "press", "raise", "both", "skin"]
"""The paper's touches; those of good conductors on a sheet of a lab; presses that lower conductance; touches that raise
it; both ways; as the skin says."""

TOUCH_KINDS: Final[tuple[TouchKind, ...]] = get_args(TouchKind)

TOUCH_KIND_OF_DRAW: Final[dict[str, ways.TouchKind]] = {
    "hard": "raise",
    "firm": "raise",
    "raise": "raise",
    "press": "lower",
    "both": "both",
}
"""Kind of touches that were drawn -> which way they change conductance; the skin's own go the skin's way."""

LARGEST_SHARE: Final = 0.7
"""Of the sheet's shorter side that a touch may take."""

USUAL_SHARP: Final = 0.25

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Ranges:
    """The distribution of touches."""

    way: ways.TouchKind
    lowering: Range = (0.2, 0.85)
    """Contrasts of those that lower conductance, log-uniform over classes."""
    raising: Range = (1.2, 200.0)
    """Contrasts of those that raise it."""
    sizes_mm: Range = (8.0, 25.0)
    """Of discs' diameters, ellipses' axes, rectangles' sides."""
    borders_mm: Range = (MIN_BORDER_MM, 8.0)
    """Widths of graded borders; none are graded where the upper one is too little for that."""
    sharp: float = USUAL_SHARP
    """Share of the borders that are sharp."""
    hard_shapes: bool = True
    """Whether half of those that raise conductance have the sharp shapes of hard touches, of any size."""


FIRM_RANGES: Final = Ranges("raise", raising=(5.0, 200.0), borders_mm=(MIN_BORDER_MM, 4.0))
"""Of ``firm``."""


def ranges_of(kind: str, skin: Skin) -> Ranges:
    """Return the distribution of touches of a kind on a skin.

    Raises:
        ValueError: There are no such touches, or the skin's do not fit on its sheet.
    """
    if kind not in TOUCH_KINDS:
        raise ValueError(f"touches {kind!r} are unknown; expected one of {', '.join(TOUCH_KINDS)}")
    if kind == "firm":
        return FIRM_RANGES
    if kind != "skin":
        return Ranges(TOUCH_KIND_OF_DRAW[kind])
    said = skin.touches
    low, high = said.size_mm
    most = LARGEST_SHARE * min(skin.outline.size_mm)
    if low > most:
        raise ValueError(f"[touches] size_mm begins at {low:g}, expected at most {most:g} on this sheet")
    soft = max(said.border_mm[0], MIN_BORDER_MM), max(said.border_mm[1], MIN_BORDER_MM)
    sharp = 1.0 if said.border_mm[1] < MIN_BORDER_MM else 0.0 if said.border_mm[0] >= MIN_BORDER_MM else USUAL_SHARP
    sizes, shapes = (low, min(high, most)), low <= SMALLEST_MM and high >= LARGEST_MM
    return Ranges(skin.touch_kind, said.lowering_contrast, said.raising_contrast, sizes, soft, sharp, shapes)


SMALLEST_MM: Final = 5.0
LARGEST_MM: Final = 25.0
"""Sides of rectangles and diameters of discs (issue: 5 to 25 mm)."""

LONGEST_MM: Final = 80.0
"""The longest bar."""

WIDEST_MM: Final = 14.0
"""The widest bar or arm of an L."""

CONTRAST: Final = (20.0, 200.0)
"""S/m of a touch; the untouched sheet has 1."""

SHAPE_CHANCES: Final = (0.42, 0.3, 0.14, 0.14)
"""Chances of a rectangle, a disc, a bar, an L."""

CLASSES: Final = 32
"""Conductivities in a pool; touch i has the one of class i % CLASSES."""


def touch_pool(
    count: int, generator: np.random.Generator, size_mm: tuple[float, float] = PAPER.outline.size_mm
) -> TouchTable:
    """Return ``count`` random touches on a sheet of some size, one a set, of one or two pieces each."""
    low, high = np.log(CONTRAST)
    stratum = (np.arange(CLASSES) + generator.random(CLASSES)) / CLASSES
    sigma = np.exp(low + (high - low) * stratum)[np.arange(count) % CLASSES]
    kind = generator.choice(len(SHAPE_CHANCES), count, p=SHAPE_CHANCES)
    pieces = np.empty((count, 2, 7))
    missing = np.arange(count)
    while len(missing):
        drawn = _draw_hard(kind[missing], generator, size_mm)
        half = half_extents_mm(drawn.reshape(-1, 7)).reshape(-1, 2, 2)
        inside = (drawn[:, :, 1:3] >= half) & (drawn[:, :, 1:3] <= np.array(size_mm) - half)
        fits = inside.all(axis=(1, 2))
        pieces[missing[fits]] = drawn[fits]
        missing = missing[~fits]
    pieces[:, :, 6] = sigma[:, None]
    own = np.ones((count, 2), dtype=np.bool_)
    own[:, 1] = kind == 3
    return TouchTable(pieces[own], np.concatenate([[0], np.cumsum(own.sum(axis=1))]).astype(np.int64))


def _draw_hard(kind: npt.NDArray[np.integer], generator: np.random.Generator, size_mm: tuple[float, float]) -> Array:
    """Return (n, 2, 7) pieces of touches of some kinds, which may leave the sheet; all but L's are one, twice."""
    count = len(kind)
    where = generator.uniform((0.0, 0.0), size_mm, (count, 2))
    angle = np.where(generator.random(count) < 0.5, generator.uniform(0.0, 90.0, count), 0.0)
    sides = generator.uniform(SMALLEST_MM, LARGEST_MM, (count, 2))
    long, thin = generator.uniform(LARGEST_MM, LONGEST_MM, count), generator.uniform(SMALLEST_MM, WIDEST_MM, count)
    upright = generator.random(count) < 0.5
    bar = np.where(upright[:, None], np.stack([thin, long], axis=-1), np.stack([long, thin], axis=-1))
    sides = np.where((kind == 2)[:, None], bar, sides)
    sides[kind == 1, 1] = sides[kind == 1, 0]
    angle[kind == 1] = 0.0
    form = np.where(kind == 1, DISC, RECTANGLE)
    one = np.column_stack([form, where, sides, angle, np.ones(count)])
    found = np.stack([one, one], axis=1)
    ells = kind == 3
    found[ells] = _ells(one[ells], thin[ells], generator)
    return found


def _ells(one: Array, width: Array, generator: np.random.Generator) -> Array:
    """Return (n, 2, 7): two arms that meet in a corner at a place; the second begins where the first ends."""
    count = len(one)
    first, second = generator.uniform(np.maximum(12.0, 1.5 * width), 45.0, (2, count))
    sign = generator.choice((-1.0, 1.0), (2, count))
    zero = np.zeros(count)
    local = np.stack(
        [np.stack([sign[0] * (first - width) / 2, zero], axis=-1), np.stack([zero, sign[1] * second / 2], axis=-1)],
        axis=1,
    )  # the second arm starts at the first one's border, width / 2 from the corner
    turn = np.deg2rad(one[:, 5])
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    arms = np.stack([one, one], axis=1)
    arms[:, :, 1] += cos * local[..., 0] - sin * local[..., 1]
    arms[:, :, 2] += sin * local[..., 0] + cos * local[..., 1]
    arms[:, :, 3] = np.stack([first, width], axis=-1)
    arms[:, :, 4] = np.stack([width, second - width], axis=-1)
    return arms


PRESS_SHAPE_CHANCES: Final = (0.45, 0.35, 0.2)
"""Chances of a disc, an ellipse, a rectangle."""

DEPTHS_MM: Final = (5.0, 22.0)
"""Depths of presses; the measured ones are 10, 15 and 20 mm."""

STRENGTH_MM2: Final = 99.0
"""Conductance that a press of 10 mm depth takes away, over the sheet's conductivity, times area."""

DEPTH_EXPONENT: Final = 1.45
"""Strength goes with depth to this."""

LOG_STRENGTH_SD: Final = 0.2
"""Standard deviation of the logarithm of the strength at one depth: quartiles are 1.3 apart."""

MAX_AXIS_RATIO: Final = 2.0
"""The most that one axis is longer than the other."""

MAX_STRENGTH_DRAWS: Final = 300
"""Draws of a strength until a size that fits is drawn by itself; of the usual presses one in ten fits."""


def pool_of(kind: str, count: int, generator: np.random.Generator, skin: Skin = PAPER) -> TouchTable:
    """Return ``count`` random touches of a kind on a sheet, one a set; those of one class have one contrast.

    Args:
        kind: Which touches.
        count: How many.
        generator: Where draws come from.
        skin: Of the sheet.

    Raises:
        ValueError: The kind is unknown, or the skin's own do not fit on its sheet.
    """
    ranges, size_mm = ranges_of(kind, skin), skin.outline.size_mm
    if kind == "hard":
        return touch_pool(count, generator, size_mm)
    number = np.arange(count)
    contrast = contrasts_of(ranges, CLASSES, generator)[number % CLASSES]
    plain = np.flatnonzero(ranges.hard_shapes & (contrast > 1.0) & (number // CLASSES % 2 == 1))
    pressed = np.setdiff1d(number, plain)
    pieces = _presses_on_sheet(contrast[pressed], generator, size_mm, ranges)
    own: dict[int, Array] = {int(at): piece[None] for at, piece in zip(pressed, pieces, strict=True)}
    shapes = touch_pool(len(plain), generator, size_mm)
    for row, at in enumerate(plain.tolist()):
        own[at] = shapes.of(row).copy()
        own[at][:, 6] = contrast[at]
    return gather([np.zeros((0, 8)), *(own[at] for at in range(count))]).chosen(number + 1)


def _presses_on_sheet(
    contrast: Array, generator: np.random.Generator, size_mm: tuple[float, float], ranges: Ranges
) -> Array:
    """Return (n, 8) presses of given contrasts (n,), their outlines on the sheet."""
    pieces = _draw_presses(contrast, generator, size_mm, ranges)
    half, middle_mm = half_extents_mm(pieces), np.array(size_mm) / 2
    while len(missing := np.flatnonzero((np.abs(pieces[:, 1:3] - middle_mm) > middle_mm - half).any(axis=1))):
        pieces[missing, 1:3] = generator.uniform((0.0, 0.0), size_mm, (len(missing), 2))
    return pieces


def _draw_presses(
    contrast: Array, generator: np.random.Generator, size_mm: tuple[float, float], ranges: Ranges
) -> Array:
    """Return (n, 8) presses of given contrasts (n,), which may reach over the sheet's border."""
    count, (low, high) = len(contrast), ranges.sizes_mm
    pieces = np.empty((count, 8))
    missing, tries = np.arange(count), 0
    while len(missing):
        tries += 1
        area = _areas(contrast[missing], generator, ranges.sizes_mm)
        form = generator.choice((DISC, ELLIPSE, RECTANGLE), len(missing), p=PRESS_SHAPE_CHANCES)
        longest = MAX_AXIS_RATIO if tries < MAX_STRENGTH_DRAWS else min(MAX_AXIS_RATIO, high / low)
        ratio = np.where(form == DISC, 1.0, np.exp(generator.uniform(0.0, np.log(longest), len(missing))))
        full = np.where(form == RECTANGLE, 1.0, np.pi / 4)
        width = np.sqrt(area / full / ratio) if tries < MAX_STRENGTH_DRAWS else generator.uniform(low, high / ratio)
        fits = (width >= low) & (width * ratio <= high * (1.0 + 1e-12))
        chosen = missing[fits]
        pieces[chosen, 0], pieces[chosen, 3], pieces[chosen, 4] = form[fits], (width * ratio)[fits], width[fits]
        missing = missing[~fits]
    pieces[:, 1:3] = generator.uniform((0.0, 0.0), size_mm, (count, 2))
    pieces[:, 5] = np.where(pieces[:, 0] == DISC, 0.0, generator.uniform(0.0, 180.0, count))
    pieces[:, 6] = contrast
    border = np.minimum(generator.uniform(*ranges.borders_mm, count), pieces[:, 4])
    pieces[:, 7] = np.where(generator.random(count) < ranges.sharp, 0.0, border)
    return pieces


def _areas(contrast: Array, generator: np.random.Generator, sizes_mm: tuple[float, float]) -> Array:
    """Return (n,) areas, mm^2: of those that lower conductance by their strength."""
    count = len(contrast)
    depth = generator.uniform(*DEPTHS_MM, count)
    strength = (
        STRENGTH_MM2 * (depth / 10.0) ** DEPTH_EXPONENT * np.exp(LOG_STRENGTH_SD * generator.standard_normal(count))
    )
    even = np.pi / 4 * generator.uniform(*sizes_mm, count) ** 2
    return np.where(contrast < 1.0, strength / np.abs(1.0 - contrast), even)


def contrasts_of(ranges: Ranges, classes: int, generator: np.random.Generator) -> Array:
    """Return (classes,) contrasts, each from its share of a range; of touches both ways every second one raises."""
    raising = np.arange(classes) % 2 == 1 if ranges.way == "both" else np.full(classes, ranges.way == "raise")
    found = np.empty(classes)
    for which, bounds in ((~raising, ranges.lowering), (raising, ranges.raising)):
        number = np.count_nonzero(which)
        low, high = np.log(bounds)
        found[which] = np.exp(low + (high - low) * (np.arange(number) + generator.random(number)) / max(number, 1))
    return found
