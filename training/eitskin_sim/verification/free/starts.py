"""Where a search starts: the touches of the network's map as rectangles, one each, or two of one that is an L.

A touch is what the stream says it is: pixels and the share that it has of each. A rectangle has the moments of its
shares. It is upright, unless one along the touch draws the map much better, or two, cut apart along a row or a column
of pixels: then the touch starts turned, or as two.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.mesh import Index
from eitskin_sim.scene.touch_table import ELLIPSE, RECTANGLE, Array, cover, pixel_lines
from eitskin_sim.verification.free.usual import Usual

BETTER: Final = 0.45
"""Two rectangles leave less than this share of what one leaves."""

PIXELS: Final = 2.5
"""What one rectangle leaves, in squares of whole pixels, before two are thought of."""

TURNED: Final = 0.8
"""A turned rectangle leaves less than this share of what an upright one leaves."""

TURNED_PIXELS: Final = 1.5
"""What an upright rectangle leaves before a turned one is thought of: that may come out upright all the same."""

AS_GOOD: Final = 1.5
"""Times of what two rectangles leave that a turned one may leave, to be taken first: it is one touch."""

MOVED_MM: Final = 15.0
"""What a touch moves from frame to frame at most, or it is another."""

LOG_CONTRAST_OF_NEITHER_SIGN: Final = float(np.log(40.0))
"""With which a start is tried where touches may raise conductance or lower it."""

LEAST_MM: Final = 3.0
"""The shortest side of a start."""


def starts_of(shares: Array, grid: Grid = PAPER.grid, *, turned: bool = True) -> Array:
    """Return (m, 8) rectangles of contrast 1 that draw a map's touches.

    Args:
        shares: (n, rows, columns) of the map, what each touch has of every pixel; ``shares_of`` of the stream's.
        grid: Of the map.
        turned: Whether some may be turned; else all are upright.
    """
    found = [_one_or_two(np.maximum(share, 0.0), grid, turned=turned) for share in shares]
    return np.concatenate([np.zeros((0, 8)), *found])


def shares_of(pixels: Index, touch: Index, weights: Array, count: int, grid: Grid = PAPER.grid) -> Array:
    """Return (n, rows, columns) shares from the stream's lists of pixels, touches and weights.

    Args:
        pixels: (m,) numbers in the map with its border of one pixel.
        touch: (m,) the touch of each.
        weights: (m,) its share.
        count: Of touches, n.
        grid: Of the map.
    """
    rows, columns = grid.shape
    found = np.zeros((count, rows + 2, columns + 2))
    found.reshape(count, (rows + 2) * (columns + 2))[touch, pixels] = weights
    return found[:, 1:-1, 1:-1]


def presses_of(rectangles: Array, border_mm: float) -> Array:
    """Return (n, 8) ellipses with a graded border, of the rectangles' areas: what presses into a soft layer are."""
    found = rectangles.copy()
    found[:, 0] = ELLIPSE
    found[:, 3:5] *= 2.0 / np.sqrt(np.pi)
    found[:, 7] = np.minimum(border_mm, found[:, 3:5].min(axis=1, initial=np.inf) - 0.01)
    return found


def followed(last: Array, rectangles: Array, before: Array | None = None) -> Array:
    """Return the last frame's (n, 8) touches, moved as the network shows that they moved.

    Args:
        last: Touches as they were found.
        rectangles: (m, 8) what the network shows now.
        before: (k, 8) what it showed then: where it is off it still is, so its own move counts. None takes its places.
    """
    now = _nearest(last, rectangles)
    if now is None:
        return last
    found = last.copy()
    then = None if before is None else _nearest(last, before)
    found[:, 1:3] = rectangles[now, 1:3]
    if before is not None and then is not None:
        found[:, 1:3] += last[:, 1:3] - before[then, 1:3]
    return found


def _nearest(last: Array, rectangles: Array) -> Index | None:
    """Return which rectangle is nearest to each touch; None if there are not as many, each near one."""
    if len(last) != len(rectangles) or not len(last):
        return None
    apart = np.hypot(*(last[:, None, 1:3] - rectangles[None, :, 1:3]).transpose(2, 0, 1))
    nearest = apart.argmin(axis=1)
    if len(np.unique(nearest)) < len(last) or (apart.min(axis=1) > MOVED_MM).any():
        return None
    return np.asarray(nearest, dtype=np.intp)


def rectangle(share: Array, grid: Grid) -> Array:
    """Return the (8,) upright rectangle with the area and the moments of (rows, columns) shares."""
    middle, spread = _moments(share, grid)
    return _of_moments(share, grid, middle, np.diag(spread), 0.0)


def turned_rectangle(share: Array, grid: Grid) -> Array:
    """Return the (8,) rectangle likewise, along (rows, columns) shares."""
    middle, spread = _moments(share, grid)
    own, ways = np.linalg.eigh(spread)
    angle_deg = float(np.rad2deg(np.arctan2(ways[1, 1], ways[0, 1]))) % 180.0
    return _of_moments(share, grid, middle, own[::-1], angle_deg)


def _moments(share: Array, grid: Grid) -> tuple[Array, Array]:
    """Return the (2,) middle and the (2, 2) second moments about it, in mm and mm2, less those of a pixel."""
    total = max(float(share.sum()), 1e-9)
    x, y = ((np.arange(count) + 0.5) * pitch for count, pitch in zip(share.shape[::-1], grid.pixel_mm, strict=True))
    middle = np.array([share.sum(axis=0) @ x, share.sum(axis=1) @ y]) / total
    x, y = x - middle[0], y - middle[1]
    spread = np.diag([share.sum(axis=0) @ x**2, share.sum(axis=1) @ y**2]) / total
    spread[0, 1] = spread[1, 0] = y @ share @ x / total
    return middle, spread - np.diag(np.square(grid.pixel_mm)) / 12.0


def _of_moments(share: Array, grid: Grid, middle: Array, spread: Array, angle_deg: float) -> Array:
    sides = np.maximum(np.sqrt(12.0 * np.maximum(spread, 0.0)), LEAST_MM)
    area = max(float(share.sum()) * grid.pixel_mm2, LEAST_MM**2)
    sides *= np.clip(np.sqrt(area / sides.prod()), 0.7, 1.3)
    return np.array([RECTANGLE, *middle, *sides, angle_deg, 1.0, 0.0])


def _drawn(pieces: list[Array], grid: Grid) -> Array:
    found, lines = np.zeros(grid.shape), pixel_lines(grid)
    for piece in pieces:
        rows, columns, share = cover(piece, *lines)
        found[rows, columns] += share
    return np.minimum(found, 1.0)


def _one_or_two(share: Array, grid: Grid, *, turned: bool) -> Array:
    """Return (1 or 2, 8) rectangles: an upright one, a turned one, or two upright ones."""

    def left_by(*pieces: Array) -> float:
        return float(np.sum((_drawn(list(pieces), grid) - share) ** 2))

    one = rectangle(share, grid)
    left = best = left_by(one)
    found = [one]
    if left > PIXELS:
        for pieces in _pairs(share, grid):
            if (other := left_by(*pieces)) < min(best, BETTER * left):
                best, found = other, pieces
    if turned and left > TURNED_PIXELS:
        along = turned_rectangle(share, grid)
        if left_by(along) < min(TURNED * left, AS_GOOD * best):
            found = [along]
    return np.array(found)


def _pairs(share: Array, grid: Grid) -> Iterator[list[Array]]:
    """Yield two rectangles for every row or column of pixels along which (rows, columns) shares may be cut."""
    for axis in (0, 1):
        there = np.flatnonzero((share > 0.3).any(axis=1 - axis))
        for cut in there[1:]:
            before = np.arange(share.shape[axis]) < cut
            first = np.where(before[:, None] if axis == 0 else before, share, 0.0)
            yield [rectangle(first, grid), rectangle(share - first, grid)]


def tries_of(rectangles: Array, upright: Array | None, usual: Usual) -> list[Array]:
    """Return (n, 8) touches of the usual contrast, each to start from, the likeliest first.

    Args:
        rectangles: (n, 8) that draw the map.
        upright: (m, 8) of these as upright ones, where some are turned: what two touches make of a map may look as one
            that lies across. None where none are.
        usual: What touches are like.
    """
    found = []
    for drawn in (rectangles, upright):
        if drawn is not None and len(drawn):
            found.append(presses_of(drawn, usual.border_mm) if usual.sign < 0 else drawn.copy())
            found[-1][:, 6] = np.exp(usual.log_contrast or LOG_CONTRAST_OF_NEITHER_SIGN)
    return found
