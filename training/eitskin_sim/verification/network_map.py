"""Converts the network's map to rectangles from which a fit starts, and finds the touches that the map shows.

A touch of the map is the stream's: its pixels, and its share of each. It starts as the upright rectangle with the
moments of its shares; as a turned one if that draws the map much better; or, as an L does, as two upright ones, cut
apart along a row or a column of pixels.
"""

from collections.abc import Iterator

import numpy as np

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.arrays import Array, Index
from eitskin_sim.scene.gap import gap_mm
from eitskin_sim.scene.touch_table import ELLIPSE, RECTANGLE, cover, pixel_lines
from eitskin_sim.shapes.parameters import parameters_of
from eitskin_sim.verification import constants as c
from eitskin_sim.verification.touch_prior import Joints, TouchPrior, crack_mm

ELLIPSE_SIDES_OF_RECTANGLE = 2.0 / float(np.sqrt(np.pi))
"""Of the same area."""


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


def map_of(pieces: Array, grid: Grid = PAPER.grid) -> Array:
    """Return the (rows, columns) touched share of every pixel; what touches share counts once, as nearly as it can."""
    lines = pixel_lines(grid)
    total = np.zeros(grid.shape)
    for number, piece in enumerate(pieces):
        before = pieces[:number]
        overlaps = len(before) and (gap_mm(np.tile(piece, (number, 1)), before) < -c.OVERLAP_MM).any()
        rows, columns, share = cover(piece, *lines)
        total[rows, columns] += share * (1.0 - total[rows, columns] if overlaps else 1.0)
    return np.asarray(np.clip(total, 0.0, 1.0))


def rectangles_of(shares: Array, grid: Grid = PAPER.grid, *, turned: bool = True) -> Array:
    """Return (m, 8) rectangles of contrast 1 that draw a map's touches.

    Args:
        shares: (n, rows, columns) of the map, what each touch has of every pixel.
        grid: Of the map.
        turned: Whether some may be turned; else all are upright.
    """
    found = [_one_or_two(np.maximum(share, 0.0), grid, turned=turned) for share in shares]
    return np.concatenate([np.zeros((0, 8)), *found])


def starts_of(shares: Array, prior: TouchPrior, grid: Grid = PAPER.grid) -> list[Array]:
    """Return (m, 8) touches of the usual contrast, each to start a fit from, the likeliest first.

    The map of two touches may look like one turned touch, so upright ones follow turned ones. Presses into a soft layer
    are ellipses with a graded border. No touches come last.
    """
    drawn = [rectangles_of(shares, grid)]
    if drawn[0][:, 5].any():
        drawn.append(rectangles_of(shares, grid, turned=False))
    found = [of_signs(pieces, np.full(len(pieces), prior.sign), prior) for pieces in drawn]
    return [pieces for pieces in found if len(pieces)] + [np.zeros((0, 8))]


def of_signs(rectangles: Array, signs: Array, prior: TouchPrior) -> Array:
    """Return rectangles (n, 8) as touches of the usual contrast of signs (n,), presses where they lower conductance."""
    found, press = rectangles.copy(), signs < 0
    found[:, 6] = np.exp(prior.usual(signs))
    found[press, 0] = ELLIPSE
    found[press, 3:5] *= ELLIPSE_SIDES_OF_RECTANGLE
    found[press, 7] = np.minimum(c.BORDER_MM, found[press, 3:5].min(axis=1, initial=np.inf) - 0.01)
    return found


def turned_rectangle(share: Array, grid: Grid) -> Array:
    """Return the (8,) rectangle with the area and the moments of (rows, columns) shares, along them."""
    middle, spread = _moments(share, grid)
    own, ways = np.linalg.eigh(spread)
    angle_deg = float(np.rad2deg(np.arctan2(ways[1, 1], ways[0, 1]))) % 180.0
    return _of_moments(share, grid, middle, own[::-1], angle_deg)


def _upright_rectangle(share: Array, grid: Grid) -> Array:
    middle, spread = _moments(share, grid)
    return _of_moments(share, grid, middle, np.diag(spread), 0.0)


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
    sides = np.maximum(np.sqrt(12.0 * np.maximum(spread, 0.0)), c.MIN_START_SIDE_MM)
    area = max(float(share.sum()) * grid.pixel_mm2, c.MIN_START_SIDE_MM**2)
    sides *= np.clip(np.sqrt(area / sides.prod()), 0.7, 1.3)
    return np.array([RECTANGLE, *middle, *sides, angle_deg, 1.0, 0.0])


def _one_or_two(share: Array, grid: Grid, *, turned: bool) -> Array:
    """Return (1 or 2, 8) rectangles: an upright one, a turned one, or two upright ones."""
    lines = pixel_lines(grid)

    def misfit(*pieces: Array) -> float:
        drawn = np.zeros(grid.shape)
        for piece in pieces:
            rows, columns, covered = cover(piece, *lines)
            drawn[rows, columns] += covered
        return float(np.sum((np.minimum(drawn, 1.0) - share) ** 2))

    upright = _upright_rectangle(share, grid)
    of_one = best = misfit(upright)
    found = [upright]
    if of_one > c.MIN_MISFIT_TO_CUT_PX:
        for pieces in _cuts(share, grid):
            if (other := misfit(*pieces)) < min(best, c.MAX_MISFIT_RATIO_OF_TWO * of_one):
                best, found = other, pieces
    if turned and of_one > c.MIN_MISFIT_TO_TURN_PX:
        along = turned_rectangle(share, grid)
        if misfit(along) < min(c.MAX_MISFIT_RATIO_OF_TURNED * of_one, c.MAX_MISFIT_RATIO_TURNED_TO_TWO * best):
            found = [along]
    return np.array(found)


def _cuts(share: Array, grid: Grid) -> Iterator[list[Array]]:
    """Yield two rectangles for every row or column of pixels along which (rows, columns) shares may be cut."""
    for axis in (0, 1):
        there = np.flatnonzero((share > c.MIN_SHARE_TO_CUT).any(axis=1 - axis))
        for cut in there[1:]:
            before = np.arange(share.shape[axis]) < cut
            first = np.where(before[:, None] if axis == 0 else before, share, 0.0)
            yield [_upright_rectangle(first, grid), _upright_rectangle(share - first, grid)]


def shown_as_large(piece: Array, shares: Array, grid: Grid) -> bool:
    """Return whether the network's map shows a touch (8,) as large as it was found, along and across."""
    if not len(shares):
        return False
    rectangles = rectangles_of(shares, grid)
    nearest = rectangles[np.argmin(np.hypot(*(rectangles[:, 1:3] - piece[1:3]).T))]
    sides = (np.sort(one[3:5]) for one in (nearest, piece))
    return bool(np.abs(np.log(np.divide(*sides))).max() < c.MAX_LOG_RATIO_OF_SAME_SIDES)


def joints_of(pieces: Array, shares: Array, grid: Grid) -> Joints:
    """Return which touches the network shows as one and physics less than a pixel apart, in pairs.

    Args:
        pieces: (m, 8) touches.
        shares: (n, rows, columns) of the network's map.
        grid: Of the map.
    """
    if len(pieces) < 2 or not len(shares):
        return ()
    upright = (pieces[:, 0] == RECTANGLE) & (pieces[:, 5] == 0.0)
    one, other = np.tril_indices(len(pieces), -1)
    near = upright[one] & upright[other] & (gap_mm(pieces[one], pieces[other]) < c.MAX_CRACK_MM)
    if not near.any():
        return ()
    owner = np.array([np.einsum("rc,nrc->n", map_of(piece[None], grid), shares).argmax() for piece in pieces])
    near &= owner[one] == owner[other]
    return tuple(zip(one[near].tolist(), other[near].tolist(), strict=True))


def without_cracks(pieces: Array, shares: Array, grid: Grid) -> Array:
    """Return touches of which those that the network shows as one have grown over the cracks between them.

    No frame tells a crack of a millimetre between the two rectangles of an L.
    """
    found = pieces.copy()
    for one, other in joints_of(pieces, shares, grid):
        wide, axis = crack_mm(parameters_of(found), (one, other))
        if wide > 0.0:
            small, large = sorted((one, other), key=lambda number: float(found[number, 3 + axis]))
            way = np.sign(found[large, 1 + axis] - found[small, 1 + axis])
            found[small, 3 + axis] += wide
            found[small, 1 + axis] += way * wide / 2.0
    return found
