"""Touch sets drawn from a pool of touches: one to eight of them apart from each other, or none.

Neighbours keep a gap of 1 mm or more, so a pair 10 mm apart, which must be told apart, is well inside what is drawn. In
half of the sets all touches have one conductivity. A set whose map may resemble a published phantom's is left out and
another drawn: its correlation is bounded from above by sums over its touches, whose maps are made once a pool.
"""

from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.grid import N_PIXELS
from eitskin_sim.barred import PHANTOM_RECTS_MM
from eitskin_sim.free_gap import gap_mm, half_extents_mm
from eitskin_sim.free_patterns import CLASSES
from eitskin_sim.free_sets import PartSets
from eitskin_sim.free_touches import RECTANGLE, Array, FreeTouches, gather
from eitskin_sim.mesh import Index

COUNTS: Final = (0.02, 0.29, 0.21, 0.16, 0.11, 0.09, 0.07, 0.03, 0.02)
"""Chances of 0, 1 .. 8 touches."""

GAP_MM: Final = 1.0
"""The least distance between two touches."""

RESEMBLES: Final = 0.97
"""A map with at least this correlation to a phantom's is that phantom, slightly moved."""

ATTEMPTS: Final = 40
"""Touches tried for a place in a set before the set does without it."""


def draw_sets(pool: FreeTouches, count: int, generator: np.random.Generator) -> PartSets:
    """Return ``count`` sets of a pool's touches."""
    if not count:
        return PartSets(np.zeros(0, dtype=np.intp), np.zeros(1, dtype=np.intp))
    bar, near = _Bar(pool), _near(pool)
    found = _draw(near, count, generator)
    while True:
        barred = np.flatnonzero(bar.may_resemble(found))
        if not len(barred):
            break
        found[barred] = _draw(near, len(barred), generator)
    taken = found >= 0
    return PartSets(found[taken], np.concatenate([[0], np.cumsum(taken.sum(axis=1))]))


def _draw(near: npt.NDArray[np.bool_], count: int, generator: np.random.Generator) -> Index:
    """Return (count, 8) numbers of touches, -1 after the last; (p + 1, p + 1) ``near`` says which exclude others."""
    total = len(near) - 1
    most = len(COUNTS) - 1
    wanted = generator.choice(most + 1, count, p=COUNTS)
    shared = generator.random(count) < 0.5
    own_class = generator.integers(min(CLASSES, total), size=count)
    found = np.full((count, most), -1, dtype=np.intp)
    for place in range(most):
        missing = np.flatnonzero(wanted > place)
        for _ in range(ATTEMPTS):
            if not len(missing):
                break
            drawn = generator.integers(total, size=len(missing))
            of_class = drawn - drawn % CLASSES + own_class[missing]
            of_class = np.where(of_class < total, of_class, own_class[missing])
            candidate = np.where(shared[missing], of_class, drawn)
            others = found[missing, :place]  # -1 is none, and the last row of the table is near nothing
            free = ~near[candidate[:, None], others].any(axis=1)
            found[missing[free], place] = candidate[free]
            missing = missing[~free]
    order = np.argsort(found < 0, axis=1, kind="stable")
    return np.take_along_axis(found, order, axis=1)


def _near(pool: FreeTouches) -> npt.NDArray[np.bool_]:
    """Return (p + 1, p + 1) which touches of a pool come closer to each other than the least gap."""
    pieces = pool.pieces
    near = np.zeros((len(pieces), len(pieces)), dtype=np.bool_)
    reach = np.hypot(*half_extents_mm(pieces).T)
    for number, piece in enumerate(pieces):
        apart = np.hypot(*(pieces[:, 1:3] - piece[1:3]).T) - reach - reach[number]
        maybe = np.flatnonzero(apart < GAP_MM)
        near[number, maybe] = gap_mm(np.repeat(piece[None], len(maybe), axis=0), pieces[maybe]) < GAP_MM
    first = pool.first[:-1]
    found = np.zeros((len(pool) + 1, len(pool) + 1), dtype=np.bool_)
    found[:-1, :-1] = np.logical_or.reduceat(np.logical_or.reduceat(near, first, axis=0), first, axis=1)
    return found


class _Bar:
    """Upper bounds of correlations between maps of sets and the published phantoms'.

    Touches of a set overlap no other, so the square of a set's map is at least the sum of its touches' squares.
    """

    def __init__(self, pool: FreeTouches) -> None:
        maps = pool.area_table()
        self._product: Array = np.append(maps @ phantom_maps().T, np.zeros((1, len(phantom_maps()))), axis=0)
        self._square: Array = np.append(np.asarray(maps.multiply(maps).sum(axis=1)).ravel(), 0.0)
        self._sum: Array = np.append(np.asarray(maps.sum(axis=1)).ravel(), 0.0)

    def may_resemble(self, sets: Index) -> npt.NDArray[np.bool_]:
        """Return which of (n, 8) sets may correlate with a phantom by ``RESEMBLES`` or more."""
        product, square, total = (table[sets].sum(axis=1) for table in (self._product, self._square, self._sum))
        length = np.sqrt(np.maximum(square - total**2 / N_PIXELS, 1e-12))
        return np.asarray((product >= RESEMBLES * length[:, None]).any(axis=1))


@lru_cache(maxsize=1)
def phantom_maps() -> Array:
    """Return the (8, 1350) area maps of the published phantoms, without mean and of length 1."""
    sets = [
        np.array([[RECTANGLE, (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0, 0.0, 50.0] for x0, y0, x1, y1 in rects])
        for rects in PHANTOM_RECTS_MM.values()
    ]
    maps = gather(sets).area_table().toarray()
    maps -= maps.mean(axis=1, keepdims=True)
    return np.asarray(maps / np.linalg.norm(maps, axis=1, keepdims=True))
