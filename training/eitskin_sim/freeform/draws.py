"""Touch sets drawn from a pool of touches: one to eight of them apart from each other, or none.

Touches are drawn one after the other, so the first k of a set are themselves a set as k touches would be drawn. Sets
come in chains, each the one before and a touch more: fewer factors to make (:mod:`eitskin_sim.freeform.voltages`),
and as many sets of every size as if each were drawn for itself, since every size is rarer than the one below. ::

    a   a b   a b c   a b c d           chains begin with touches in turn, so sets of one touch hardly recur
    e   e f   e f g
    h

Neighbours keep a gap of 1 mm or more, so a pair 10 mm apart, which must be told apart, is well inside what is drawn.
Touches that lie near to each other are the hardest to tell from one, and are rare where touches fall anywhere: in a
share of the chains each touch is the nearest of several to the one before. In half of the sets all touches have one
conductivity. A set whose map may resemble a published phantom's is left out and
another drawn: its correlation is bounded from above by sums over its touches, whose maps are made once a pool.

A few deformations share a pool of touches. A tenth of it is held out, and so are the sets made of these: no touch of a
set that is held out occurs in one that is learned from, at any deformation.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import count as count_up
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array, Index
from eitskin_sim.freeform.sets import PartSets
from eitskin_sim.freeform.touches import CLASSES, pool_of
from eitskin_sim.scene.gap import gap_mm, half_extents_mm
from eitskin_sim.scene.published import PHANTOM_RECTS_MM
from eitskin_sim.scene.touch_table import RECTANGLE, TouchTable, gather

COUNT_CHANCES: Final = (0.02, 0.29, 0.21, 0.16, 0.11, 0.09, 0.07, 0.03, 0.02)
"""Chances of 0, 1 .. 8 touches."""

GAP_MM: Final = 1.0
"""The least distance between two touches."""

CLUSTERED_SHARE: Final = 1 / 3
"""Share of the chains whose touches lie near to each other, unless another is asked for."""

NEAREST_CANDIDATES: Final = 8
"""Touches of which the nearest to the one before is tried there: then half of the pairs are about 25 mm apart or less,
from middle to middle."""

PHANTOM_CORRELATION: Final = 0.97
"""A map with at least this correlation to a phantom's is that phantom, slightly moved."""

ATTEMPTS: Final = 40
"""Touches tried for a place in a chain before the chain ends there."""

MAX_REDRAWS: Final = 4
"""Times that chains which ended early are drawn again; then their largest sets have fewer touches."""


class SetDrawer:
    """Draws sets of a pool's touches; what it must know of pairs of touches and of their maps is found once.

    Args:
        pool: The touches.
        near: Share of the chains whose touches lie near to each other.
        grid: Of the sheet that they lie on.
    """

    def __init__(self, pool: TouchTable, near: float = CLUSTERED_SHARE, grid: Grid = PAPER.grid) -> None:
        self._clustered = near
        self._near = near_table(pool)
        self._middle_mm = middles_mm(pool)
        self._bar = Bar(pool, grid)

    def draw(self, count: int, generator: np.random.Generator) -> PartSets:
        """Return ``count`` sets."""
        if not count:
            return PartSets(np.zeros(0, dtype=np.intp), np.zeros(1, dtype=np.intp))
        total = len(self._near) - 1
        wanted = np.bincount(generator.choice(len(COUNT_CHANCES), count, p=COUNT_CHANCES), minlength=len(COUNT_CHANCES))
        chain = np.concatenate([np.arange(number) for number in wanted])
        size = np.repeat(np.arange(len(COUNT_CHANCES)), wanted)
        length = np.zeros(max(wanted[1:].max(), 1), dtype=np.intp)
        np.maximum.at(length, chain[size > 0], size[size > 0])
        turns = -(-len(length) // total)
        begin = np.concatenate([generator.permutation(total) for _ in range(turns)])[: len(length)]
        found = self._families(begin, length, generator)
        order = generator.permutation(count)
        own = found[np.where(size > 0, chain, 0)[order]]
        taken = (own >= 0) & (np.arange(own.shape[1]) < size[order, None])
        return PartSets(own[taken], np.concatenate([[0], np.cumsum(taken.sum(axis=1))]))

    def _families(self, begin: Index, length: Index, generator: np.random.Generator) -> Index:
        """Return (f, 8) touches of chains, -1 after the last, from their first ones and lengths."""
        shared = generator.random(len(length)) < 0.5
        tries = np.where(generator.random(len(length)) < self._clustered, NEAREST_CANDIDATES, 1)
        found = _draw(self._near, self._middle_mm, begin, length, shared, tries, generator)
        for attempt in count_up():
            again = self._bar.may_resemble(found)
            if attempt < MAX_REDRAWS:
                again |= (found >= 0).sum(axis=1) < length
            rows = np.flatnonzero(again)
            if not len(rows):
                break
            begin = generator.integers(len(self._near) - 1, size=len(rows))
            found[rows] = _draw(self._near, self._middle_mm, begin, length[rows], shared[rows], tries[rows], generator)
        return found


def _draw(
    near: npt.NDArray[np.bool_],
    middle_mm: Array,
    begin: Index,
    length: Index,
    shared: npt.NDArray[np.bool_],
    tries: Index,
    generator: np.random.Generator,
) -> Index:
    """Return (f, 8) numbers of touches of chains, -1 after the last.

    Args:
        near: (p + 1, p + 1) which touches exclude each other; the last is none.
        middle_mm: (p, 2) their middles.
        begin: (f,) their first touches.
        length: (f,) how many they shall have.
        shared: (f,) whether all have the first one's conductivity.
        tries: (f,) of how many touches the nearest to the one before is taken.
        generator: Where draws come from.
    """
    total, most = len(near) - 1, len(COUNT_CHANCES) - 1
    own_class = begin % CLASSES
    found = np.full((len(begin), most), -1, dtype=np.intp)
    found[:, 0] = np.where(length > 0, begin, -1)
    for place in range(1, most):
        missing = np.flatnonzero((length > place) & (found[:, place - 1] >= 0))
        for _ in range(ATTEMPTS):
            if not len(missing):
                break
            drawn = generator.integers(total, size=(len(missing), NEAREST_CANDIDATES))
            of_class = drawn - drawn % CLASSES + own_class[missing, None]
            of_class = np.where(of_class < total, of_class, own_class[missing, None])
            drawn = np.where(shared[missing, None], of_class, drawn)
            candidate = drawn[:, 0]
            several = np.flatnonzero(tries[missing] > 1)
            before = found[missing[several], place - 1]
            apart = np.hypot(*(middle_mm[drawn[several]] - middle_mm[before, None]).transpose(2, 0, 1))
            excluded = near[drawn[several], before[:, None]] | (
                np.arange(NEAREST_CANDIDATES) >= tries[missing[several], None]
            )
            nearest = np.where(excluded, np.inf, apart).argmin(axis=1)
            candidate[several] = drawn[several, nearest]
            free = ~near[candidate[:, None], found[missing, :place]].any(axis=1)
            found[missing[free], place] = candidate[free]
            missing = missing[~free]
    return found


def near_table(pool: TouchTable) -> npt.NDArray[np.bool_]:
    """Return (p + 1, p + 1) which touches of a pool come closer to each other than the least gap; the last is none."""
    pieces = pool.pieces
    reach = np.hypot(*half_extents_mm(pieces).T)
    one, other = np.triu_indices(len(pieces))
    apart = np.hypot(*(pieces[one, 1:3] - pieces[other, 1:3]).T) - reach[one] - reach[other]
    maybe = apart < GAP_MM
    one, other = one[maybe], other[maybe]
    close = gap_mm(pieces[one], pieces[other]) < GAP_MM
    owner = np.repeat(np.arange(len(pool)), np.diff(pool.first))
    a, b = owner[one[close]], owner[other[close]]
    found = np.zeros((len(pool) + 1, len(pool) + 1), dtype=np.bool_)
    found[a, b] = found[b, a] = True
    return found


def middles_mm(pool: TouchTable) -> Array:
    """Return (p, 2) the middles of a pool's touches: the mean of their pieces' middles."""
    sums = np.add.reduceat(pool.pieces[:, 1:3], pool.first[:-1], axis=0) if len(pool) else np.empty((0, 2))
    return np.asarray(sums / np.diff(pool.first)[:, None])


class Bar:
    """Upper bounds of correlations between maps of sets and the published phantoms'.

    Touches of a set overlap no other, so the square of a set's map is at least the sum of its touches' squares.
    """

    def __init__(self, pool: TouchTable, grid: Grid = PAPER.grid) -> None:
        maps, phantoms = pool.area_table(grid), phantom_maps(grid)
        self._pixels = grid.n_pixels
        self._product: Array = np.append(maps @ phantoms.T, np.zeros((1, len(phantoms))), axis=0)
        self._square: Array = np.append(np.asarray(maps.multiply(maps).sum(axis=1)).ravel(), 0.0)
        self._sum: Array = np.append(np.asarray(maps.sum(axis=1)).ravel(), 0.0)

    def may_resemble(self, found: Index) -> npt.NDArray[np.bool_]:
        """Return which of (f, 8) chains have a set that may correlate with a phantom by ``PHANTOM_CORRELATION``."""
        product, square, total = (table[found].cumsum(axis=1) for table in (self._product, self._square, self._sum))
        length = np.sqrt(np.maximum(square - total**2 / self._pixels, 1e-12))
        return np.asarray((product >= PHANTOM_CORRELATION * length[..., None]).any(axis=(1, 2)))


@lru_cache(maxsize=4)
def phantom_maps(grid: Grid = PAPER.grid) -> Array:
    """Return the (8, pixels) area maps of the published phantoms, without mean and of length 1.

    They were published for the paper's sheet; one of another size has none.
    """
    if grid.size_mm != PAPER.grid.size_mm:
        return np.zeros((0, grid.n_pixels))
    sets = [
        np.array([[RECTANGLE, (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0, 0.0, 50.0] for x0, y0, x1, y1 in rects])
        for rects in PHANTOM_RECTS_MM.values()
    ]
    maps = gather(sets).area_table(grid).toarray()
    maps -= maps.mean(axis=1, keepdims=True)
    return np.asarray(maps / np.linalg.norm(maps, axis=1, keepdims=True))


TOUCHES_PER_SET: Final = 0.2
"""Touches of a pool for each set that a deformation shows; more are more varied, and take longer."""

MIN_POOL_TOUCHES: Final = 2 * CLASSES
"""Touches that a pool has at least."""


@dataclass(frozen=True, slots=True)
class SetPool:
    """Touches, and the sets of them that deformations show.

    Args:
        parts: One touch each.
        sets: By number of the deformation; those held out come last.
    """

    parts: TouchTable
    sets: dict[int, PartSets]

    def touches(self, sets: PartSets) -> TouchTable:
        """Return sets as a table of pieces."""
        drawn = self.parts.chosen(sets.member)
        return TouchTable(drawn.pieces, drawn.first[sets.first])


def set_pool(
    counts: dict[int, tuple[int, int]],
    seed: int,
    near: float = CLUSTERED_SHARE,
    touches: str = "hard",
    skin: Skin = PAPER,
) -> SetPool:
    """Return the pool of some deformations and their touch sets.

    Args:
        counts: By number of the deformation, how many sets it shows and how many of them are held out.
        seed: Of the data set.
        near: Share of the chains of sets whose touches lie near to each other.
        touches: Which touches, see :mod:`eitskin_sim.freeform.touches`.
        skin: Of the sheet that they lie on.
    """
    first = min(counts)
    learned = max(total - held for total, held in counts.values())
    held = max(held for _, held in counts.values())
    pools = []
    for kind, size in enumerate((learned, held)):
        generator = np.random.default_rng([seed, 4, first, kind])
        many = max(MIN_POOL_TOUCHES, round(TOUCHES_PER_SET * size)) if size else 0
        pools.append(pool_of(touches, many, generator, skin))
    drawers = [SetDrawer(pool, near, skin.grid) for pool in pools]
    sets = {}
    for number, (total, apart) in counts.items():
        generator = np.random.default_rng([seed, 5, number])
        own = [drawer.draw(size, generator) for drawer, size in zip(drawers, (total - apart, apart), strict=True)]
        sets[number] = PartSets(
            np.concatenate([own[0].member, own[1].member + len(pools[0])]),
            np.concatenate([own[0].first, own[0].first[-1] + own[1].first[1:]]),
        )
    pieces = np.concatenate([pool.pieces for pool in pools])
    starts = np.concatenate([pools[0].first, pools[0].first[-1] + pools[1].first[1:]])
    return SetPool(TouchTable(pieces, starts), sets)
