"""Random presses: discs, ellipses and rectangles of 8 to 25 mm, with soft borders, that lower or raise conductance.

Measured presses of hydrogel skins by a 5 mm probe, 10 / 15 / 20 mm deep, take 99 / 176 / 269 mm^2 of conductance away
(change over the sheet's conductivity, times area; as depth^1.45, quartiles 1.2 to 1.4 apart), and change voltages by
0.7 to 1.8 % (median row). So a press is drawn by its contrast, 0.2 to 0.85, and its strength: depth is uniform from 5
to 22 mm, strength follows it with that spread, and size follows from both; one outside 8 to 25 mm is drawn again.

    press    all lower conductance, contrast 0.2 to 0.85, by strength as above
    raise    all raise it, contrast 1.2 to 200 log-uniform: half of them any size from 8 to 25 mm with borders as
             below, half of the sharp shapes of hard touches, bars and L's among them
    both     half of the touches lower it so; a quarter raises it, contrast 1.2 to 200 log-uniform, any size from 8 to
             25 mm; a quarter has that contrast and the sharp shapes of hard touches, bars and L's among them

A quarter of the borders of presses is sharp, the others are graded over 0.5 to 8 mm, at most over the press's width.
"""

from typing import Final, Literal

import numpy as np

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.freeform.patterns import CLASSES, touch_pool
from eitskin_sim.scene.gap import half_extents_mm
from eitskin_sim.scene.soft_touch import LEAST_BORDER_MM
from eitskin_sim.scene.touch_table import DISC, ELLIPSE, RECTANGLE, Array, TouchTable, gather

TouchKind = Literal["hard", "press", "raise", "both"]
"""The paper's touches of contrast 20 to 200; presses that lower conductance; touches that raise it; both ways."""

TOUCH_KINDS: Final[tuple[TouchKind, ...]] = ("hard", "press", "raise", "both")

LOWERING: Final = (0.2, 0.85)
"""Contrasts of presses that lower conductance, log-uniform over classes."""

RAISING: Final = (1.2, 200.0)
"""Contrasts of presses that raise it."""

SIZES_MM: Final = (8.0, 25.0)
"""Of discs' diameters, ellipses' axes, rectangles' sides."""

BORDERS_MM: Final = (LEAST_BORDER_MM, 8.0)
"""Widths of graded borders."""

SHARP: Final = 0.25
"""Share of the borders that are sharp."""

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


def pool_of(
    kind: TouchKind, count: int, generator: np.random.Generator, size_mm: tuple[float, float] = PAPER.outline.size_mm
) -> TouchTable:
    """Return ``count`` random touches of a kind on a sheet, one a set; those of one class have one contrast.

    Args:
        kind: Which touches.
        count: How many.
        generator: Where draws come from.
        size_mm: Length and width of the sheet.

    Raises:
        ValueError: The kind is unknown.
    """
    if kind not in TOUCH_KINDS:
        raise ValueError(f"touches {kind!r} are unknown; expected one of {', '.join(TOUCH_KINDS)}")
    if kind == "hard":
        return touch_pool(count, generator, size_mm)
    number = np.arange(count)
    contrast = contrasts_of(kind, CLASSES, generator)[number % CLASSES]
    plain = np.flatnonzero((contrast > 1.0) & (number // CLASSES % 2 == 1))
    pressed = np.setdiff1d(number, plain)
    pieces = _on_sheet(contrast[pressed], generator, size_mm)
    own: dict[int, Array] = {int(at): piece[None] for at, piece in zip(pressed, pieces, strict=True)}
    shapes = touch_pool(len(plain), generator, size_mm)
    for row, at in enumerate(plain.tolist()):
        own[at] = shapes.of(row).copy()
        own[at][:, 6] = contrast[at]
    return gather([np.zeros((0, 8)), *(own[at] for at in range(count))]).chosen(number + 1)


def _on_sheet(contrast: Array, generator: np.random.Generator, size_mm: tuple[float, float]) -> Array:
    """Return (n, 8) presses of given contrasts (n,), their outlines on the sheet."""
    pieces = _draw(contrast, generator, size_mm)
    half, middle_mm = half_extents_mm(pieces), np.array(size_mm) / 2
    while len(missing := np.flatnonzero((np.abs(pieces[:, 1:3] - middle_mm) > middle_mm - half).any(axis=1))):
        pieces[missing, 1:3] = generator.uniform((0.0, 0.0), size_mm, (len(missing), 2))
    return pieces


def _draw(contrast: Array, generator: np.random.Generator, size_mm: tuple[float, float]) -> Array:
    """Return (n, 8) presses of given contrasts (n,), which may reach over the sheet's border."""
    count = len(contrast)
    pieces = np.empty((count, 8))
    missing = np.arange(count)
    while len(missing):
        area = _areas(contrast[missing], generator)
        form = generator.choice((DISC, ELLIPSE, RECTANGLE), len(missing), p=FORMS)
        ratio = np.where(form == DISC, 1.0, np.exp(generator.uniform(0.0, np.log(LONGEST), len(missing))))
        full = np.where(form == RECTANGLE, 1.0, np.pi / 4)
        width = np.sqrt(area / full / ratio)
        fits = (width >= SIZES_MM[0]) & (width * ratio <= SIZES_MM[1])
        chosen = missing[fits]
        pieces[chosen, 0], pieces[chosen, 3], pieces[chosen, 4] = form[fits], (width * ratio)[fits], width[fits]
        missing = missing[~fits]
    pieces[:, 1:3] = generator.uniform((0.0, 0.0), size_mm, (count, 2))
    pieces[:, 5] = np.where(pieces[:, 0] == DISC, 0.0, generator.uniform(0.0, 180.0, count))
    pieces[:, 6] = contrast
    border = np.minimum(generator.uniform(*BORDERS_MM, count), pieces[:, 4])
    pieces[:, 7] = np.where(generator.random(count) < SHARP, 0.0, border)
    return pieces


def _areas(contrast: Array, generator: np.random.Generator) -> Array:
    """Return (n,) areas, mm^2: of those that lower conductance by their strength."""
    count = len(contrast)
    depth = generator.uniform(*DEPTHS_MM, count)
    strength = STRENGTH_MM2 * (depth / 10.0) ** POWER * np.exp(SPREAD * generator.standard_normal(count))
    even = np.pi / 4 * generator.uniform(*SIZES_MM, count) ** 2
    return np.where(contrast < 1.0, strength / np.abs(1.0 - contrast), even)


def contrasts_of(kind: TouchKind, classes: int, generator: np.random.Generator) -> Array:
    """Return (classes,) contrasts, each from its share of a range: presses lower conductance, of both every second."""
    raising = np.arange(classes) % 2 == 1 if kind == "both" else np.full(classes, kind == "raise")
    found = np.empty(classes)
    for which, bounds in ((~raising, LOWERING), (raising, RAISING)):
        number = np.count_nonzero(which)
        low, high = np.log(bounds)
        found[which] = np.exp(low + (high - low) * (np.arange(number) + generator.random(number)) / max(number, 1))
    return found
