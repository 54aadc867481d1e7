"""Touches anywhere: a table of rectangles, discs and ellipses, of any size and conductivity, and their labels.

One row of seven numbers a piece, or of eight where borders are graded ::

    kind  x  y  length  width  angle  sigma  [border]   kind 0: a rectangle about (x, y), turned by ``angle`` degrees
     -   mm  mm   mm     mm     deg   S/m       mm      kind 1: a disc of diameter ``length``
                                                        kind 2: an ellipse of axes ``length`` and ``width``

sigma is that of the touch where the sheet has 1: its contrast. Over a graded border log sigma is linear, half of it at
the outline, so a label knows nothing of it: it is the share inside the contour of half height. A touch is one piece,
or two that meet (an L). Pieces of a set never overlap, so areas add up. A label is the touched share of each pixel's
area. It is exact along y, and exact along x for rectangles that are not turned; for other
outlines x is cut into 32 strips a cell, which leaves 1e-4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.arrays import Array
from eitskin_sim.scene.parts import Touch
from eitskin_sim.scene.shapes import Disc, Ellipse, Polygon, Rect, Shape

RECTANGLE: Final = 0.0
DISC: Final = 1.0
ELLIPSE: Final = 2.0

STRIPS: Final = 32
"""Strips that a cell is cut into along x, for outlines that are not parallel to it."""


@lru_cache(maxsize=16)
def pixel_lines(grid: Grid) -> tuple[Array, Array]:
    """Return the (columns + 1,) borders of the map's pixels along x, and the (rows + 1,) along y, mm, for reading."""
    (length, width), (rows, columns) = grid.size_mm, grid.shape
    found = np.linspace(0.0, length, columns + 1), np.linspace(0.0, width, rows + 1)
    for one in found:
        one.setflags(write=False)
    return found


@dataclass(frozen=True, slots=True)
class TouchTable:
    """Touch sets as one table.

    Args:
        pieces: (P, 7) kind, x, y, length, width, angle, sigma; or (P, 8) with the border's width.
        first: (T + 1,) where each set's pieces begin; the last is P.
    """

    pieces: Array
    first: npt.NDArray[np.int64]

    def __len__(self) -> int:
        """Return how many sets there are."""
        return len(self.first) - 1

    def of(self, number: int) -> Array:
        """Return the (p, 7 or 8) pieces of one set."""
        return self.pieces[self.first[number] : self.first[number + 1]]

    def chosen(self, numbers: npt.NDArray[np.integer]) -> "TouchTable":
        """Return some of the sets."""
        counts = np.diff(self.first)[numbers]
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        rows = np.arange(first[-1]) + np.repeat(self.first[numbers] - first[:-1], counts)
        return TouchTable(self.pieces[rows], first)

    def area_table(self, grid: Grid = PAPER.grid) -> csr_array:
        """Return the (T, pixels) touched shares, sparse; a piece that recurs is measured once.

        Shares of a pixel that several pieces touch add up; they may pass 1 by rounding.
        """
        lines = pixel_lines(grid)
        unique, back = np.unique(self.pieces[:, :6], axis=0, return_inverse=True)
        shares, pixels, first = [], [], np.zeros(len(unique) + 1, dtype=np.int64)
        for number, piece in enumerate(unique):
            rows, columns, share = cover(np.append(piece, 0.0), *lines)
            at = np.flatnonzero(share)
            row, column = np.divmod(at, share.shape[1])
            pixels.append((rows.start + row) * grid.shape[1] + columns.start + column)
            shares.append(share.ravel()[at])
            first[number + 1] = first[number] + len(at)
        empty = np.zeros(0)
        maps = csr_array(
            (np.concatenate([*shares, empty]), np.concatenate([*pixels, empty.astype(np.intp)]), first),
            (len(unique), grid.n_pixels),
        )
        ones = np.ones(len(self.pieces))
        return csr_array((ones, back.ravel(), self.first), (len(self), len(unique))) @ maps

    def touches(self, number: int) -> tuple[Touch, ...]:
        """Return one set as a scene's touches."""
        own = self.of(number)
        borders = borders_mm(own).tolist()
        return tuple(
            Touch((shape_of(piece),), float(piece[6]), float(piece[6]) if border else None, border)
            for piece, border in zip(own, borders, strict=True)
        )


def gather(sets: Sequence[Array]) -> TouchTable:
    """Return touch sets from a list of (p, 7 or 8) pieces."""
    first = np.concatenate([[0], np.cumsum([len(pieces) for pieces in sets])]).astype(np.int64)
    wide = max((pieces.shape[1] for pieces in sets), default=7)
    return TouchTable(np.concatenate([*(_widened(pieces, wide) for pieces in sets), np.empty((0, wide))]), first)


def _widened(pieces: Array, columns: int) -> Array:
    return np.pad(pieces, ((0, 0), (0, columns - pieces.shape[1])))


def borders_mm(pieces: Array) -> Array:
    """Return (P,) the widths of pieces' graded borders; 0 is sharp."""
    return pieces[:, 7] if pieces.shape[1] > 7 else np.zeros(len(pieces))


def corners(piece: Array) -> Array:
    """Return the (4, 2) corners of a rectangle, counter-clockwise."""
    _, x, y, length, width, angle = piece[:6]
    local = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * (length / 2, width / 2)
    turn = np.deg2rad(angle)
    cos, sin = np.cos(turn), np.sin(turn)
    return np.asarray(local @ np.array([[cos, sin], [-sin, cos]]) + (x, y))


def shape_of(piece: Array) -> Shape:
    """Return one piece as a scene's shape."""
    kind, x, y, length, width, angle = (float(value) for value in piece[:6])
    if kind == DISC:
        return Disc(x, y, length / 2)
    if kind == ELLIPSE:
        return Ellipse(x, y, length, width, angle)
    if angle == 0.0:
        return Rect(x - length / 2, y - width / 2, x + length / 2, y + width / 2)
    return Polygon(tuple((float(a), float(b)) for a, b in corners(piece)))


def bounds(piece: Array) -> tuple[float, float, float, float]:
    """Return the box (x0, y0, x1, y1) around a piece, mm."""
    _, x, y, length, width, angle = (float(value) for value in piece[:6])
    if piece[0] == DISC:
        return x - length / 2, y - length / 2, x + length / 2, y + length / 2
    if piece[0] == ELLIPSE:
        return Ellipse(x, y, length, width, angle).bounds_mm
    if angle == 0.0:
        return x - length / 2, y - width / 2, x + length / 2, y + width / 2
    points = corners(piece)
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def cover(piece: Array, x_lines: Array, y_lines: Array) -> tuple[slice, slice, Array]:
    """Return the covered share of the cells between lines: rows and columns that the piece meets, and the shares there.

    Args:
        piece: (7 or 8,) one piece.
        x_lines: Ascending borders of the cells along x, mm.
        y_lines: The same along y.
    """
    x0, y0, x1, y1 = bounds(piece)
    columns, rows = _span(x_lines, x0, x1), _span(y_lines, y0, y1)
    x, y = x_lines[columns.start : columns.stop + 1], y_lines[rows.start : rows.stop + 1]
    if piece[0] == RECTANGLE and piece[5] == 0.0:
        share = np.outer(_overlap(y, y0, y1) / np.diff(y), _overlap(x, x0, x1) / np.diff(x))
        return rows, columns, share
    low, high = _chord(piece, strips_of(x))
    inside = np.clip(high, y[:-1, None], y[1:, None]) - np.clip(low, y[:-1, None], y[1:, None])
    share = inside.reshape(len(y) - 1, len(x) - 1, STRIPS).mean(axis=2) / np.diff(y)[:, None]
    return rows, columns, share


def strips_of(x_lines: Array) -> Array:
    """Return the (cells * ``STRIPS``,) middles of the strips of cells between lines along x."""
    middles = (np.arange(STRIPS) + 0.5) / STRIPS
    return np.asarray((x_lines[:-1, None] + np.diff(x_lines)[:, None] * middles).ravel())


def _span(lines: Array, low: float, high: float) -> slice:
    start = max(int(np.searchsorted(lines, low, side="right")) - 1, 0)
    stop = min(max(int(np.searchsorted(lines, high, side="left")), start + 1), len(lines) - 1)
    return slice(min(start, len(lines) - 2), stop)


def _overlap(lines: Array, low: float, high: float) -> Array:
    return np.asarray(np.clip(np.minimum(lines[1:], high) - np.maximum(lines[:-1], low), 0.0, None))


def _chord(piece: Array, x_mm: Array) -> tuple[Array, Array]:
    """Return where vertical lines enter and leave a piece; both the same where they miss it."""
    _, x, y, length, width, angle = piece[:6]
    if piece[0] == ELLIPSE:
        return _chord_of_ellipse(x_mm - x, y, length / 2, width / 2, np.deg2rad(angle))
    if piece[0] == DISC:
        half = np.sqrt(np.maximum((length / 2) ** 2 - (x_mm - x) ** 2, 0.0))
        return y - half, y + half
    turn = np.deg2rad(angle)
    low, high = np.full(len(x_mm), -np.inf), np.full(len(x_mm), np.inf)
    for along_x, along_y, half in ((np.cos(turn), np.sin(turn), length / 2), (-np.sin(turn), np.cos(turn), width / 2)):
        offset = (x_mm - x) * along_x
        if abs(along_y) < 1e-12:
            missed = np.abs(offset) > half
            low, high = np.where(missed, np.inf, low), np.where(missed, -np.inf, high)
            continue
        ends = np.sort(np.stack([(-half - offset) / along_y, (half - offset) / along_y]), axis=0)
        low, high = np.maximum(low, ends[0]), np.minimum(high, ends[1])
    missed = high <= low
    return np.where(missed, y, y + low), np.where(missed, y, y + high)


def _chord_of_ellipse(x_mm: Array, y_mm: float, a_mm: float, b_mm: float, turn: float) -> tuple[Array, Array]:
    """Return where the lines x enter and leave an ellipse about (0, y), from p y^2 + 2 q x y + r x^2 = 1."""
    cos, sin = np.cos(turn), np.sin(turn)
    p, r = (sin / a_mm) ** 2 + (cos / b_mm) ** 2, (cos / a_mm) ** 2 + (sin / b_mm) ** 2
    q = sin * cos * (1.0 / a_mm**2 - 1.0 / b_mm**2)
    half = np.sqrt(np.maximum(q * q * x_mm**2 - p * (r * x_mm**2 - 1.0), 0.0)) / p
    middle = np.where(half > 0.0, y_mm - q * x_mm / p, y_mm)
    return middle - half, middle + half
