"""What touches of a skin are like, before anything is measured: the prior of a fit."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from eitskin_proto.skin.parts import Range
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.verification.prior import Prior

BEYOND: Final = 0.3
"""Standard deviation of a contrast's logarithm about the range that a skin states: no range is a wall."""

PLACES: Final = 60
"""Areas of a sheet that can be told apart, roughly."""

EXPECTED: Final = 3.0
"""Touches at once."""


@dataclass(frozen=True, slots=True)
class Usual:
    """What this skin's touches are like."""

    log_contrast: float = float(np.log(40.0))
    common_sd: float = 0.8
    """Of the mean log contrast."""
    own_sd: float = 0.3
    """Of each touch about it."""
    aspect_sd: float = 0.35
    """Of log(length / width): most touches are about as long as wide, and some are long, so its tails are heavy."""
    border_mm: float = 3.0
    border_sd: float = 2.0
    sign: int = 0
    """Of every log contrast: 1 where touches raise conductance, -1 where they lower it, 0 where both happen."""
    touches: Prior = field(default_factory=lambda: Prior(places=PLACES, expected=EXPECTED))


def usual_of(kind: TouchKind, skin: Skin = PAPER) -> Usual:
    """Return what is usual of a skin whose touches go one way, or both: contrasts and sizes that it states."""
    middle, spread = _log_uniform(skin.touches.size_mm)
    touches = Prior(PLACES, EXPECTED, float(np.exp(middle)), float(np.hypot(spread, 0.1)))
    if kind == "both":
        return Usual(log_contrast=0.0, common_sd=2.0, own_sd=1.5, touches=touches)
    stated = skin.touches.lowering_contrast if kind == "lower" else skin.touches.raising_contrast
    middle, spread = _log_uniform(stated)
    sign = -1 if kind == "lower" else 1
    return Usual(log_contrast=middle, common_sd=float(np.hypot(spread, BEYOND)), sign=sign, touches=touches)


def _log_uniform(stated: Range) -> tuple[float, float]:
    """Return mean and standard deviation of the logarithm of what lies evenly, by logarithm, within a range."""
    low, high = np.log(stated)
    return float((low + high) / 2.0), float((high - low) / np.sqrt(12.0))
