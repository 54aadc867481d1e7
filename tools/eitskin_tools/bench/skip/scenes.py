"""Untouched and touched sheets at deformations that nothing was fitted on, also moving, as log(V / V0).

Every bend is drawn from a seed that neither data sets nor the gate's export use. A motion goes from flat to a bend and
is solved at twelve amplitudes; between two of them log V is taken as linear. A growing touch is a square whose contrast
rises from 1 to the weakest that is called a touch. What was solved is kept for the next gate.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.parts import Bend

SEED: Final = 9105
"""Of bends; unlike any of eitskin_export and of the data sets."""

STEPS: Final = 12
"""Amplitudes at which a motion is solved, and contrasts at which a growing touch is."""

CONTRAST: Final = 20.0
"""S/m of the weakest touch."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Motion:
    """A sheet, or a touch on it, that changes with time.

    Args:
        family: "flat", "A" or "B".
        keys: (k, 104) log(V / V0) at evenly spaced times.
    """

    family: str
    keys: Array

    def frames(self, count: int) -> Array:
        """Return (count, 104) log(V / V0), evenly spaced in time."""
        at = np.linspace(0.0, len(self.keys) - 1.0, count)
        low = np.minimum(at.astype(np.intp), len(self.keys) - 2)
        share = (at - low)[:, None]
        return np.asarray((1.0 - share) * self.keys[low] + share * self.keys[low + 1])


def bends_of(family: str, count: int) -> tuple[Bend, ...]:
    """Return deformations of a family by name; the flat one alone is "flat"."""
    from eitskin_sim.scene.family import draw

    return (Bend(),) if family == "flat" else draw("A" if family == "A" else "B", count, SEED)


@cache
def still(family: str, count: int) -> Array:
    """Return (count, 104) log(V / V0) of untouched sheets at rest."""
    from eitskin_training.gate.untouched import untouched_logs

    return untouched_logs(bends_of(family, count), PAPER)


@cache
def moving(family: str, count: int) -> tuple[Motion, ...]:
    """Return untouched sheets on their way from flat to a bend."""
    from eitskin_sim.scene.family import scaled
    from eitskin_training.gate.untouched import untouched_logs

    amplitudes = np.linspace(0.0, 1.0, STEPS)
    return tuple(
        Motion(family, untouched_logs([scaled(bend, float(share)) for share in amplitudes], PAPER))
        for bend in bends_of(family, count)
    )


@cache
def growing(family: str, count: int, side_mm: float) -> tuple[Motion, ...]:
    """Return touches in the middle of sheets at rest, from nothing to the weakest contrast."""
    from eitskin_sim.freeform.sheet import inverted_sheet
    from eitskin_sim.freeform.voltages import set_voltages
    from eitskin_sim.scene.touch_table import gather
    from eitskin_training.gate.touches import squares

    contrasts = contrasts_of_growth()
    sets = gather([squares([(75.0, 50.0)], side_mm, float(contrast))[0] for contrast in contrasts[1:]])
    flat_V = inverted_sheet(Bend()).untouched_V
    found = []
    for bend in bends_of(family, count):
        sheet = inverted_sheet(bend)
        voltages = np.concatenate([sheet.untouched_V[None], set_voltages([sheet], sets)[0]])
        found.append(Motion(family, np.log(np.maximum(voltages / flat_V, 1e-6))))
    return tuple(found)


def contrasts_of_growth() -> Array:
    """Return the (k,) contrasts of a growing touch's keys, evenly spaced in logarithm from 1."""
    return np.asarray(np.geomspace(1.0, CONTRAST, STEPS))


def first_above(values: Sequence[bool] | npt.NDArray[np.bool_]) -> int | None:
    """Return the first index that is true, or None."""
    found = np.flatnonzero(values)
    return int(found[0]) if len(found) else None
