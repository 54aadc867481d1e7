"""Random touches off the unit grid: rectangles, discs, bars and L's, and pools of them.

::

    rectangle  5 to 25 mm each way        bar  5 to 14 mm by 25 to 80 mm
    disc       5 to 25 mm across          L    two arms of 12 to 45 mm, 5 to 14 mm wide

Half of them are turned by any angle. Conductivity is log-uniform from 20 to 200 S/m. A pool holds touches of
``CLASSES`` conductivities, one after the other: a set whose touches share one takes them from one class
(:mod:`eitskin_sim.freeform.draws`).
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.gap import half_extents_mm
from eitskin_sim.scene.touch_table import DISC, RECTANGLE, Array, TouchTable

SMALLEST_MM: Final = 5.0
LARGEST_MM: Final = 25.0
"""Sides of rectangles and diameters of discs (issue: 5 to 25 mm)."""

LONGEST_MM: Final = 80.0
"""The longest bar."""

WIDEST_MM: Final = 14.0
"""The widest bar or arm of an L."""

CONTRAST: Final = (20.0, 200.0)
"""S/m of a touch; the untouched sheet has 1."""

KINDS: Final = (0.42, 0.3, 0.14, 0.14)
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
    kind = generator.choice(len(KINDS), count, p=KINDS)
    pieces = np.empty((count, 2, 7))
    missing = np.arange(count)
    while len(missing):
        drawn = _draw(kind[missing], generator, size_mm)
        half = half_extents_mm(drawn.reshape(-1, 7)).reshape(-1, 2, 2)
        inside = (drawn[:, :, 1:3] >= half) & (drawn[:, :, 1:3] <= np.array(size_mm) - half)
        fits = inside.all(axis=(1, 2))
        pieces[missing[fits]] = drawn[fits]
        missing = missing[~fits]
    pieces[:, :, 6] = sigma[:, None]
    own = np.ones((count, 2), dtype=np.bool_)
    own[:, 1] = kind == 3
    return TouchTable(pieces[own], np.concatenate([[0], np.cumsum(own.sum(axis=1))]).astype(np.int64))


def _draw(kind: npt.NDArray[np.integer], generator: np.random.Generator, size_mm: tuple[float, float]) -> Array:
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
