"""Random touch sets off the unit grid: rectangles, discs, bars and L's, one to eight at a time, or none.

::

    rectangle  5 to 25 mm each way        bar  5 to 14 mm by 25 to 80 mm
    disc       5 to 25 mm across          L    two arms of 12 to 45 mm, 5 to 14 mm wide

Half of them are turned by any angle. Neighbours keep a gap of 1 mm or more, so a pair 10 mm apart, which must be told
apart, is well inside what is drawn. Conductivity is log-uniform from 20 to 200 S/m, one for all touches of a set or one
each. A set whose map resembles a published phantom's is drawn again.
"""

from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.grid import SHEET_MM
from eitskin_sim.barred import PHANTOM_RECTS_MM
from eitskin_sim.free_touches import DISC, RECTANGLE, Array, FreeTouches, bounds, gather

SMALLEST_MM: Final = 5.0
LARGEST_MM: Final = 25.0
"""Sides of rectangles and diameters of discs (issue: 5 to 25 mm)."""

LONGEST_MM: Final = 80.0
"""The longest bar."""

WIDEST_MM: Final = 14.0
"""The widest bar or arm of an L."""

CONTRAST: Final = (20.0, 200.0)
"""S/m of a touch; the untouched sheet has 1."""

COUNTS: Final = (0.02, 0.29, 0.21, 0.16, 0.11, 0.09, 0.07, 0.03, 0.02)
"""Chances of 0, 1 .. 8 touches."""

KINDS: Final = (0.42, 0.3, 0.14, 0.14)
"""Chances of a rectangle, a disc, a bar, an L."""

GAP_MM: Final = 1.0
"""The least distance between two touches, up to the raster's step."""

STEP_MM: Final = 1.0
"""Raster on which overlaps are looked for."""

RESEMBLES: Final = 0.97
"""A map with at least this correlation to a phantom's is that phantom, slightly moved."""

ATTEMPTS: Final = 40
"""Places tried for a touch before the set does without it."""


def free_touch_sets(count: int, seed: int) -> FreeTouches:
    """Return ``count`` random touch sets; set i depends on (seed, i) alone."""
    return chosen_touch_sets(np.arange(count), seed)


def chosen_touch_sets(numbers: npt.NDArray[np.integer], seed: int) -> FreeTouches:
    """Return some of the touch sets of a seed, by number."""
    return gather([_set(np.random.default_rng([seed, int(i)])) for i in numbers])


def _set(generator: np.random.Generator) -> Array:
    while True:
        pieces = _draw_set(generator)
        if not _could_resemble(pieces) or not resembles_phantom(gather([pieces]).areas(0)):
            return pieces


def _draw_set(generator: np.random.Generator) -> Array:
    count = int(generator.choice(len(COUNTS), p=COUNTS))
    shared = bool(generator.random() < 0.5)
    sigma = _contrast(generator)
    x, y = (np.arange(0.0, extent + STEP_MM / 2, STEP_MM) for extent in SHEET_MM)
    taken = np.zeros((len(y), len(x)), dtype=np.bool_)
    found: list[Array] = []
    for _ in range(count):
        for _ in range(ATTEMPTS):
            pieces = _touch(generator, sigma if shared else _contrast(generator))
            if not _on_sheet(pieces):
                continue
            near = np.zeros_like(taken)
            for piece in pieces:
                near |= _within(piece, x, y, GAP_MM)
            if not (near & taken).any():
                taken |= near
                found.append(pieces)
                break
    return np.concatenate([*found, np.empty((0, 7))])


def _contrast(generator: np.random.Generator) -> float:
    return float(np.exp(generator.uniform(*np.log(CONTRAST))))


def _touch(generator: np.random.Generator, sigma: float) -> Array:
    """Return the (1 or 2, 7) pieces of one touch, not yet known to lie on the sheet."""
    kind = int(generator.choice(len(KINDS), p=KINDS))
    x, y = generator.uniform((0.0, 0.0), SHEET_MM)
    quarter = 90.0 * float(generator.integers(2))
    angle = float(generator.uniform(0.0, 90.0)) if generator.random() < 0.5 else 0.0
    if kind == 1:
        size = generator.uniform(SMALLEST_MM, LARGEST_MM)
        return np.array([[DISC, x, y, size, size, 0.0, sigma]])
    if kind == 3:
        return _ell(generator, x, y, angle, sigma)
    length, width = generator.uniform(SMALLEST_MM, LARGEST_MM, 2)
    if kind == 2:
        length, width = generator.uniform(LARGEST_MM, LONGEST_MM), generator.uniform(SMALLEST_MM, WIDEST_MM)
        if quarter:
            length, width = width, length
    return np.array([[RECTANGLE, x, y, length, width, angle, sigma]])


def _ell(generator: np.random.Generator, x: float, y: float, angle: float, sigma: float) -> Array:
    """Return two arms that meet in a corner at (x, y); the second begins where the first ends."""
    width = generator.uniform(SMALLEST_MM, WIDEST_MM)
    first, second = generator.uniform(max(12.0, 1.5 * width), 45.0, 2)
    sign_x, sign_y = generator.choice((-1.0, 1.0), 2)
    centres = np.array(
        [[sign_x * (first - width) / 2, 0.0], [0.0, sign_y * second / 2]]
    )  # the second arm starts at the first one's border, width / 2 from the corner
    turn = np.deg2rad(angle)
    cos, sin = np.cos(turn), np.sin(turn)
    centres = centres @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
    return np.array(
        [
            [RECTANGLE, *centres[0], first, width, angle, sigma],
            [RECTANGLE, *centres[1], width, second - width, angle, sigma],
        ]
    )


def _on_sheet(pieces: Array) -> bool:
    boxes = np.array([bounds(piece) for piece in pieces])
    return bool((boxes[:, :2] >= 0.0).all() and (boxes[:, 2:] <= SHEET_MM).all())


def _within(piece: Array, x: Array, y: Array, gap_mm: float) -> npt.NDArray[np.bool_]:
    """Return which points of a raster lie in a piece grown by a gap."""
    kind, px, py, length, width, angle, _ = piece
    dx, dy = x[None, :] - px, y[:, None] - py
    if kind == DISC:
        return np.asarray(dx**2 + dy**2 <= (length / 2 + gap_mm) ** 2)
    cos, sin = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    along, across = np.abs(cos * dx + sin * dy), np.abs(cos * dy - sin * dx)
    return np.asarray((along <= length / 2 + gap_mm) & (across <= width / 2 + gap_mm))


@lru_cache(maxsize=1)
def _phantom_maps() -> Array:
    """Return the (8, 1350) area maps of the published phantoms, without mean and of length 1."""
    sets = [
        np.array([[RECTANGLE, (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0, 0.0, 50.0] for x0, y0, x1, y1 in rects])
        for rects in PHANTOM_RECTS_MM.values()
    ]
    table = gather(sets)
    return np.array([_centred(table.areas(i).ravel()) for i in range(len(table))])


def _centred(values: Array) -> Array:
    values = values - values.mean()
    length = float(np.linalg.norm(values))
    return np.asarray(values / length if length else values)


def resembles_phantom(areas: Array) -> bool:
    """Return whether a (30, 45) map correlates with a published phantom's by 0.97 or more."""
    return bool((_phantom_maps() @ _centred(areas.ravel()) >= RESEMBLES).any())


def _could_resemble(pieces: Array) -> bool:
    """Return whether the touched area is anywhere near a phantom's; a correlation of 0.97 allows 6 % either way."""
    area = pieces[:, 3] * pieces[:, 4] * np.where(pieces[:, 0] == DISC, np.pi / 4, 1.0)
    sums = [sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in rects) for rects in PHANTOM_RECTS_MM.values()]
    return bool(np.any(np.abs(area.sum() / np.array(sums) - 1.0) < 0.15))
