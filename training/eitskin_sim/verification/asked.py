"""One frame of touched units that is to be explained, and whether another sheet explains it better."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.verification.residual import Array, Noise, Rows
from eitskin_sim.verification.units import UnitTouch
from eitskin_sim.verification.verdict import Verdict

SPARED: Final = 0.7
"""Another model is kept if it leaves less than this part of a frame's chi-squared, or explains the frame."""

SURE: Final = 0.5
"""p from which touches that the network does not show are explained surely: as p is cautious, most right ones are."""

UnitVerdict = Verdict[UnitTouch]


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """One frame to be explained, as :meth:`eitskin_sim.verification.unit_sheet.UnitSheet.verify` takes it."""

    change: Array
    reference: Array
    starts: Sequence[npt.NDArray[np.bool_]]
    noise: Noise
    rows: Rows | None
    budget_s: float | None
    before: Sequence[UnitTouch]
    heights: Array | None

    def shown(self, verdict: UnitVerdict) -> bool:
        """Return whether a verdict has just the touches that the network shows, at one of its thresholds."""
        units = [one.unit for one in verdict.touches]
        return not len(self.starts) or any(np.array_equal(units, np.flatnonzero(one)) for one in self.starts)


def better(again: UnitVerdict, before: UnitVerdict, *, shown: bool = True) -> bool:
    """Return whether a frame is so much better explained by another model that this one is kept.

    Another sheet nearly explains some wrong touches, too. So touches that the network does not show have to be
    explained surely.

    Args:
        again: The frame's verdict by the other model.
        before: By the one in use.
        shown: Whether the network shows just these touches, at one of its thresholds.
    """
    if not shown:
        return again.p_value >= SURE
    return not again.flagged or again.chi_squared < SPARED * before.chi_squared
