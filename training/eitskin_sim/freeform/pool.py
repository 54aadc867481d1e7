"""The touches that a few deformations take from, and the touch sets that each of them shows, all of them different.

A tenth of the touches is held out, and so are the sets made of them: no touch of a set that is held out occurs in one
that is learned from, at any deformation.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.freeform.draws import CLUSTERED, SetDrawer
from eitskin_sim.freeform.patterns import CLASSES
from eitskin_sim.freeform.presses import pool_of
from eitskin_sim.freeform.sets import PartSets
from eitskin_sim.scene.touch_table import TouchTable

TOUCHES_PER_SET: Final = 0.2
"""Touches of a pool for each set that a deformation shows; more are more varied, and take longer."""

LEAST: Final = 2 * CLASSES
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
    near: float = CLUSTERED,
    touches: str = "hard",
    skin: Skin = PAPER,
) -> SetPool:
    """Return the pool of some deformations and their touch sets.

    Args:
        counts: By number of the deformation, how many sets it shows and how many of them are held out.
        seed: Of the data set.
        near: Share of the chains of sets whose touches lie near to each other.
        touches: Which touches, see :mod:`eitskin_sim.freeform.touch_kinds`.
        skin: Of the sheet that they lie on.
    """
    first = min(counts)
    learned = max(total - held for total, held in counts.values())
    held = max(held for _, held in counts.values())
    pools = []
    for kind, size in enumerate((learned, held)):
        generator = np.random.default_rng([seed, 4, first, kind])
        many = max(LEAST, round(TOUCHES_PER_SET * size)) if size else 0
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
