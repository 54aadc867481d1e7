"""Electrodes that fail, as training sees them: their rows filled in from the others, as the runtime will do it.

A network that is to go on without an electrode must have seen what stands in its rows then. Zeros are far from
anything that a sheet shows, and cost the shipped network of units a third of its CC; the conditional mean costs a
tenth before a network has seen a single one (:mod:`eitskin_sim.measurement.consistency`).
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.measurement.consistency import Filler

HOW_MANY: Final = (0.7, 0.2, 0.1)
"""Chances that one, two or three electrodes are gone, when any is."""

SETS: Final = 6
"""Different sets of electrodes in a batch: samples that lose the same ones are filled in together."""


def lose_electrodes(dv: npt.NDArray[np.float32], share: float, filler: Filler, rng: np.random.Generator) -> None:
    """Fill in, in place, the rows of one to three electrodes in some samples.

    Args:
        dv: (B, 104) relative change.
        share: Of the samples that lose electrodes.
        filler: Knows how rows go together.
        rng: Draws samples and electrodes.
    """
    samples = np.flatnonzero(rng.random(len(dv)) < share)
    for group in np.array_split(samples, SETS):
        count = int(rng.choice(len(HOW_MANY), p=HOW_MANY)) + 1
        chosen = tuple(sorted(rng.choice(N_ELECTRODES, count, replace=False).tolist()))
        if len(group):
            part = dv[group]
            filler.fill(part, chosen)
            dv[group] = part
