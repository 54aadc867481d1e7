"""Finds connected pieces of a map from runs of pixels, and splits them where a saddle divides two peaks.

A piece is made of the pixels that are at least ``HALF``, neighbours along rows and columns. It is split where every
path from one peak to the other leads at least ``SADDLE`` below the lower one: this separates two touches that merge in
the map, while noise on the flat top of one makes no second touch.

The time is bounded: a map of more than ``MOST_RUNS`` runs is not analysed, and a piece of more than ``MOST_DIVIDED``
pixels is not searched for saddles.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

HALF: Final = 0.5
"""A touch is where the map is at least one half."""

SADDLE: Final = 0.25
"""Smallest depth of the saddle below the lower of two peaks that separates two touches."""

DIVIDED_LEVEL: Final = HALF + SADDLE
"""Two peaks of one piece, of values up to 1, that a saddle divides are apart above this level as well."""

MOST_RUNS: Final = 1024
"""Most runs of pixels, row by row, of a map that is analysed."""

MOST_DIVIDED: Final = 1024
"""Most pixels of a piece that is searched for saddles."""

Indices = npt.NDArray[np.intp]


_LEVELS: Final = np.array([[HALF], [DIVIDED_LEVEL]])


def _runs(flat: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.bool_], Indices, list[int]]:
    """Return which pixels are at least ``HALF``, and the edges of their runs and of those of ``DIVIDED_LEVEL``.

    Of each run, in a row: its first pixel, and the one behind its last.
    """
    above = flat >= _LEVELS  # one behind the other, so that one search finds the edges of both
    both = above.reshape(-1)
    edges = (both[1:] != both[:-1]).nonzero()[0]
    edges += 1
    split = edges.searchsorted(flat.size)
    return above[0], edges[:split], (edges[split:] - flat.size).tolist()


def joined(starts: Sequence[int], ends: Sequence[int], width: int) -> list[int]:
    """Return the number of each run's piece: the number of the piece's first run.

    Args:
        starts: First pixels of runs, ascending.
        ends: Pixels behind the last.
        width: Pixels of a row, its border among them.
    """
    parent = list(range(len(starts)))
    other = 0
    for run, start in enumerate(starts):
        first, last = start - width, ends[run] - width  # the pixels above it, in the row before
        while ends[other] <= first:
            other += 1
        above = other
        root = run
        while starts[above] < last:
            found = above
            while parent[found] != found:
                found = parent[found]
            if found < root:
                parent[root] = root = found
            elif found > root:
                parent[found] = root
            above += 1
        parent[run] = root
    for run, found in enumerate(parent):  # each points to an earlier one, which points to its first
        parent[run] = parent[found]
    return parent


def pieces(flat: npt.NDArray[np.float64], width: int) -> tuple[Indices, Indices, int] | None:
    """Return the touched pixels, the number of each one's piece, and how many pieces there are.

    Args:
        flat: (pixels,) a finite map with a border of zeros, row by row.
        width: Pixels of a row, the border's two among them.

    Returns:
        Pixels in pieces numbered from 0, in the order of their first pixels; those on a saddle belong to none and are
        left out. None for a map in more than ``MOST_RUNS`` runs.
    """
    above, edges, high = _runs(flat)
    firsts, behind = edges[::2], edges[1::2]
    if len(firsts) > MOST_RUNS:
        return None
    starts, ends = firsts.tolist(), behind.tolist()
    number: dict[int, int] = {}
    numbers = [number.setdefault(root, len(number)) for root in joined(starts, ends, width)]
    at = above.nonzero()[0]
    of = np.repeat(np.array(numbers, dtype=np.intp), behind - firsts)
    count = len(number)
    for piece in _dividable(high, width, starts, numbers):
        mine = np.flatnonzero(of == piece)
        if mine.size > MOST_DIVIDED:
            continue
        parts = divided(at[mine].tolist(), flat[at[mine]].tolist(), width)
        more = max(parts) if parts else 0
        if more > 0:
            found = np.array(parts, dtype=np.intp)
            of[mine] = np.where(found > 0, found + (count - 1), np.where(found < 0, -1, piece))
            count += more
    if count > len(number):
        at, of = at[of >= 0], of[of >= 0]
    return at, of, count


def _dividable(high: Sequence[int], width: int, starts: Sequence[int], numbers: Sequence[int]) -> list[int]:
    """Return the pieces that are more than one above ``DIVIDED_LEVEL``: only these can have a saddle.

    Args:
        high: Edges of the runs above ``DIVIDED_LEVEL``.
        width: Pixels of a row, the border's two among them.
        starts: First pixels of the runs above ``HALF``.
        numbers: The piece of each.
    """
    tops, ends = high[::2], high[1::2]
    seen: dict[int, int] = {}
    found: list[int] = []
    run, runs = 0, len(starts)
    for top, root in zip(tops, joined(tops, ends, width), strict=True):
        while run + 1 < runs and starts[run + 1] <= top:
            run += 1
        piece = numbers[run]
        if seen.setdefault(piece, root) != root and piece not in found:
            found.append(piece)
    return found


def divided(at: Sequence[int], values: Sequence[float], width: int) -> list[int]:
    """Return the part of each pixel of one piece: 0, 1, ... by the first pixel of each, or -1 on the saddles between.

    From the highest pixel down, each joins the part that it touches, or begins one. Where it touches several, those
    that rise less than ``SADDLE`` above it join the highest; if several are left, it is on the saddle of them. Equal
    pixels go in the order of the map.

    Args:
        at: Indices of the pixels in a map with a border, ascending.
        values: Of the pixels.
        width: Pixels of a row, the border's two among them.
    """
    order = sorted(range(len(at)), key=lambda index: (-values[index], index))
    around = (-width, -1, 1, width)
    part_of: dict[int, int] = {}
    parent: list[int] = []
    peak: list[float] = []
    firm: set[int] = set()

    def root(part: int) -> int:
        while parent[part] != part:
            part = parent[part]
        return part

    for index in order:
        pixel, value = at[index], values[index]
        met = {part_of[pixel + step] for step in around if pixel + step in part_of}
        if len(met) == 1:  # nearly all pixels touch one part, or a saddle alone
            part_of[pixel] = met.pop()
            continue
        parts = {root(part) for part in met if part >= 0}
        if not parts:
            if met:
                part_of[pixel] = -1  # behind a saddle, and below it
                continue
            part_of[pixel] = len(parent)
            parent.append(len(parent))
            peak.append(value)
            continue
        highest = max(parts, key=lambda part: (peak[part], -part))
        apart = {part for part in parts if part == highest or peak[part] - value >= SADDLE}
        for part in parts - apart:
            parent[part] = highest
        if len(apart) > 1:
            firm |= apart
            part_of[pixel] = -1
        else:
            part_of[pixel] = highest
    found = [part_of[pixel] for pixel in at]
    found = [part if part < 0 else root(part) for part in found]
    proven = {root(part) for part in firm}
    names: dict[int, int] = {}
    for part in found:
        if part in proven and part not in names:
            names[part] = len(names)
    if len(names) < 2:
        return [0] * len(at)
    return [names.get(part, -1) for part in found]
