"""Random presses: discs, ellipses and rectangles of 8 to 25 mm, with soft borders, that lower or raise conductance.

Measured presses of hydrogel skins by a 5 mm probe, 10 / 15 / 20 mm deep, take 99 / 176 / 269 mm^2 of conductance away
(change over the sheet's conductivity, times area; as depth^1.45, quartiles 1.2 to 1.4 apart), and change voltages by
0.7 to 1.8 % (median row). So a press is drawn by its contrast, 0.2 to 0.85, and its strength: depth is uniform from 5
to 22 mm, strength follows it with that spread, and size follows from both; one outside 8 to 25 mm is drawn again.

    press    all lower conductance, contrast 0.2 to 0.85, by strength as above
    raise    all raise it, contrast 1.2 to 200 log-uniform: half of them any size from 8 to 25 mm with borders as
             below, half of the sharp shapes of hard touches, bars and L's among them
    firm     as raise, contrast 5 to 200, borders of up to 4 mm
    both     half of the touches lower it so; a quarter raises it, contrast 1.2 to 200 log-uniform, any size from 8 to
             25 mm; a quarter has that contrast and the sharp shapes of hard touches, bars and L's among them

    skin     the ways, contrasts, sizes and borders of the skin's description; where its sizes are from 5 to 25 mm or
             more, half of those that raise have the sharp shapes of hard touches, as above

A quarter of the borders of presses is sharp, the others are graded over 0.5 to 8 mm, at most over the press's width.
Where no measured strength goes with the skin's contrasts and sizes, sizes are drawn by themselves.
"""

from typing import Final

import numpy as np

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.freeform.patterns import CLASSES, touch_pool
from eitskin_sim.freeform.touch_kinds import Ranges, ranges_of
from eitskin_sim.scene.gap import half_extents_mm
from eitskin_sim.scene.touch_table import DISC, ELLIPSE, RECTANGLE, Array, TouchTable, gather

FORMS: Final = (0.45, 0.35, 0.2)
"""Chances of a disc, an ellipse, a rectangle."""

DEPTHS_MM: Final = (5.0, 22.0)
"""Depths of presses; the measured ones are 10, 15 and 20 mm."""

STRENGTH_MM2: Final = 99.0
"""Conductance that a press of 10 mm depth takes away, over the sheet's conductivity, times area."""

POWER: Final = 1.45
"""Strength goes with depth to this."""

SPREAD: Final = 0.2
"""Standard deviation of the logarithm of the strength at one depth: quartiles are 1.3 apart."""

LONGEST: Final = 2.0
"""The most that one axis is longer than the other."""

PATIENCE: Final = 300
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
    pieces = _on_sheet(contrast[pressed], generator, size_mm, ranges)
    own: dict[int, Array] = {int(at): piece[None] for at, piece in zip(pressed, pieces, strict=True)}
    shapes = touch_pool(len(plain), generator, size_mm)
    for row, at in enumerate(plain.tolist()):
        own[at] = shapes.of(row).copy()
        own[at][:, 6] = contrast[at]
    return gather([np.zeros((0, 8)), *(own[at] for at in range(count))]).chosen(number + 1)


def _on_sheet(contrast: Array, generator: np.random.Generator, size_mm: tuple[float, float], ranges: Ranges) -> Array:
    """Return (n, 8) presses of given contrasts (n,), their outlines on the sheet."""
    pieces = _draw(contrast, generator, size_mm, ranges)
    half, middle_mm = half_extents_mm(pieces), np.array(size_mm) / 2
    while len(missing := np.flatnonzero((np.abs(pieces[:, 1:3] - middle_mm) > middle_mm - half).any(axis=1))):
        pieces[missing, 1:3] = generator.uniform((0.0, 0.0), size_mm, (len(missing), 2))
    return pieces


def _draw(contrast: Array, generator: np.random.Generator, size_mm: tuple[float, float], ranges: Ranges) -> Array:
    """Return (n, 8) presses of given contrasts (n,), which may reach over the sheet's border."""
    count, (low, high) = len(contrast), ranges.sizes_mm
    pieces = np.empty((count, 8))
    missing, tries = np.arange(count), 0
    while len(missing):
        tries += 1
        area = _areas(contrast[missing], generator, ranges.sizes_mm)
        form = generator.choice((DISC, ELLIPSE, RECTANGLE), len(missing), p=FORMS)
        longest = LONGEST if tries < PATIENCE else min(LONGEST, high / low)
        ratio = np.where(form == DISC, 1.0, np.exp(generator.uniform(0.0, np.log(longest), len(missing))))
        full = np.where(form == RECTANGLE, 1.0, np.pi / 4)
        width = np.sqrt(area / full / ratio) if tries < PATIENCE else generator.uniform(low, high / ratio)
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
    strength = STRENGTH_MM2 * (depth / 10.0) ** POWER * np.exp(SPREAD * generator.standard_normal(count))
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
