"""Which currents touched units pass: sixteen patterns a unit, from many sets of touches, that serve every shape.

The currents of random sets, with every drive, are collected for each unit and cut down by their singular values, in the
norm of the unit's own energy. What a touched unit passes is smooth: what neighbours do to it, and what bending does,
moves within the same few patterns. Units that meet at a corner pass what no others do, so all pairs of neighbours are
among the sets. Cutting by how strongly patterns couple to the electrodes fails: units near each other couple by others.
Sets and deformations have seeds of their own.
"""

from functools import lru_cache
from typing import Final

import numpy as np

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.reduced.exact import exact_sheet
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import flat_metric_of, nominal_sheet
from eitskin_sim.unit_grid.patterns import rich_touch_sets
from eitskin_sim.unit_grid.skeleton import square_root

SEED: Final = 44_101
"""Names the sets and the deformations that patterns are made from."""

RANK: Final = 16
"""Patterns a unit."""

SETS: Final = 160
"""Sets of touches at each of two shapes."""

MOST_UNITS: Final = 12

EVEN: Final = 0.5
"""Power of a current's size that it is divided by: rare and weak patterns count, and not only strong ones."""

CONTRASTS: Final = (0.1, 200.0)
"""Least and most contrast that is collected."""


def current_patterns(skin: Skin = PAPER, rank: int = RANK) -> tuple[Array, ...]:
    """Return, for every unit, (b, rank) currents that add up to 0; 5 s once a process and skin.

    Raises:
        ValueError: More patterns are asked for than are kept.
    """
    if not 1 <= rank <= RANK:
        raise ValueError(f"{rank} patterns a unit; expected from 1 to {RANK}")
    return tuple(own[:, :rank] for own in _patterns(skin))


@lru_cache(maxsize=4)
def _patterns(skin: Skin) -> tuple[Array, ...]:
    """Return (b, RANK) currents of every unit, the strongest first."""
    rng = np.random.default_rng(SEED)
    bent = draw("A", 2, SEED, skin)[1]
    shapes = flat_metric_of(skin), bend_metric(bent, nominal_sheet(skin))
    rows, columns = skin.grid.units
    rich = rich_touch_sets(1 + SETS, SEED, (rows, columns))[1:]
    found: list[list[Array]] = [[] for _ in range(rows * columns)]
    factors: list[Array] = []
    for shape in shapes:
        sheet = exact_sheet(shape, skin)
        factors = factors or [square_root(unit.schur[0]) for unit in sheet.units]
        sets = [_drawn(rng, rows * columns) for _ in range(SETS)] + [np.flatnonzero(one) for one in rich]
        for units in sets:
            flowing, _ = sheet.currents(units, contrasts_of(len(units), rng))
            for unit, own in zip(units.tolist(), flowing, strict=True):
                found[unit].append(own)
        for pair in _neighbours(rows, columns):
            flowing, _ = sheet.currents(np.array(pair), np.full(2, 50.0))
            for unit, own in zip(pair, flowing, strict=True):
                found[unit].append(own)
    return tuple(_cut(factor, np.concatenate(own, axis=1)) for factor, own in zip(factors, found, strict=True))


def contrasts_of(count: int, rng: np.random.Generator) -> Array:
    """Return so many contrasts: half of the time all are 50, else each its own, of either sign."""
    if rng.random() < 0.5:
        return np.full(count, 50.0)
    low, high = CONTRASTS
    raised = np.exp(rng.uniform(np.log(1.5), np.log(high), count))
    lowered = np.exp(rng.uniform(np.log(low), np.log(0.8), count))
    return np.where(rng.random(count) < 0.5, raised, lowered)


def _drawn(rng: np.random.Generator, n_units: int) -> Index:
    return np.sort(rng.choice(n_units, int(rng.integers(1, MOST_UNITS + 1)), replace=False))


def _neighbours(rows: int, columns: int) -> list[tuple[int, int]]:
    """Return all pairs of units that share a side or a corner: through a corner, two touches pass what no others do."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    near = np.maximum(np.abs(row[:, None] - row), np.abs(column[:, None] - column)) == 1
    return [(int(a), int(b)) for a, b in zip(*np.nonzero(np.triu(near)), strict=True)]


def _cut(factor: Array, currents: Array) -> Array:
    """Return the patterns (b, RANK) that hold most of the energy of currents (b, n), where S = factor factor^T."""
    inner = np.linalg.lstsq(factor, currents, rcond=None)[0]
    size = np.linalg.norm(inner, axis=0)
    inner = inner[:, size > 0.0] / size[size > 0.0] ** EVEN
    left, _, _ = np.linalg.svd(inner, full_matrices=False)
    return np.asarray(factor @ left[:, :RANK])
