"""Presses of a known stamp at known places, as parameters with priors, to learn the effect of a press.

Every press is one touch with a graded border, of the stamp's shape ::

    log contrast = -+ strength exp(own)     strength of all presses; own of each: no two presses are alike
    outline      = the stamp's, larger by growth
    place        = the stated place plus a common shift plus an error of its own

Whether presses raise or lower conductance is decided by the recording.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_proto.skin.parts import Touches
from eitskin_sim.arrays import Array
from eitskin_sim.calibration.parameters import ParameterGroup, Parameters
from eitskin_sim.scene.parts import MIN_LOG_CONTRAST, Touch
from eitskin_sim.scene.shapes import Disc, Rect, Shape
from eitskin_sim.scene.soft_touch import MIN_BORDER_MM

STRENGTH: Final = "press_log_contrast"
PRESS_CONTRAST: Final = "press_own"
GROWTH: Final = "press_growth_mm"
BORDER: Final = "press_border_mm"
SHIFT: Final = "press_shift_mm"
PLACE: Final = "press_place_mm"

PRESSES: Final = (STRENGTH, PRESS_CONTRAST, GROWTH, BORDER, SHIFT, PLACE)
"""Groups of presses, which are no numbers of the skin's file."""

PRESS_CONTRAST_SD: Final = 0.15
"""Of the logarithm of one press's log contrast; quartiles of a robot's presses of one depth are 1.2 to 1.4 apart."""

GROWTH_MM: Final = 3.0
"""A soft layer yields beside the stamp too."""

SHIFT_MM: Final = 1.5
"""Where the map's origin is taken to be."""

PLACE_MM: Final = 1.0
"""How well a person hits a place."""

SMALLEST_MM: Final = 2.0
"""No outline is narrower, however small the stamp is said to be."""

Way = int
"""-1: presses lower conductance; 1: they raise it."""

WAYS: Final[tuple[Way, ...]] = (-1, 1)
"""Both are tried: the recording says which way presses go, and the skin's file does not."""


@dataclass(frozen=True, slots=True)
class Stamp:
    """A stamp with which the sheet is pressed."""

    size_mm: tuple[float, ...]
    """A disc's diameter; or length along x and width along y of a rectangle."""

    def at(self, xy_mm: Array, growth_mm: float) -> Shape:
        """Return the outline about a place (2,), larger by a growth of its diameter or sides."""
        x, y = float(xy_mm[0]), float(xy_mm[1])
        half = [max(one + growth_mm, SMALLEST_MM) / 2.0 for one in self.size_mm]
        if len(half) == 1:
            return Disc(x, y, half[0])
        return Rect(x - half[0], y - half[1], x + half[0], y + half[1])

    @property
    def name(self) -> str:
        """For people."""
        return f"disc of {self.size_mm[0]:g} mm" if len(self.size_mm) == 1 else "{:g} x {:g} mm".format(*self.size_mm)


def places(size_mm: tuple[float, float], count: int) -> tuple[tuple[float, float], ...]:
    """Return places for a stamp, spread over a sheet: rows of three, well inside.

    Args:
        size_mm: Of the sheet.
        count: How many.
    """
    rows = -(-count // 3)
    found = []
    for k in range(count):
        row, column = divmod(k, 3)
        along = min(3, count - 3 * row)
        found.append((round(size_mm[0] * (column + 1) / (along + 1)), round(size_mm[1] * (row + 1) / (rows + 1))))
    return tuple((float(x), float(y)) for x, y in found)


def groups(touches: Touches, way: Way, count: int) -> list[ParameterGroup]:
    """Return the parameters of some presses.

    Args:
        touches: The touches of the skin's description.
        way: Of ``WAYS``.
        count: How many presses.
    """
    contrast = touches.lowering_contrast if way < 0 else touches.raising_contrast
    low, high = np.sort(np.abs(np.log(contrast)))
    border = np.sqrt(max(touches.border_mm[0], 1.0) * max(touches.border_mm[1], 4.0))
    return [
        ParameterGroup(STRENGTH, "", np.array([np.sqrt(low * high)]), float(max(np.log(high / low) / 2.0, 0.3)), True),
        ParameterGroup(PRESS_CONTRAST, "", np.zeros(count), PRESS_CONTRAST_SD),
        ParameterGroup(GROWTH, "mm", np.zeros(1), GROWTH_MM),
        ParameterGroup(BORDER, "mm", np.array([border]), 0.6, True),
        ParameterGroup(SHIFT, "mm", np.zeros(2), SHIFT_MM),
        ParameterGroup(PLACE, "mm", np.zeros(2 * count), PLACE_MM),
    ]


def press(stamp: Stamp, xy_mm: Array, way: Way, number: int, parameters: Parameters) -> Callable[[Array], tuple[Touch]]:
    """Return one press as a function of all parameters z (count,).

    Args:
        stamp: The stamp.
        xy_mm: (2,) where it was said.
        way: Of ``WAYS``.
        number: Which of the presses.
        parameters: Those that z is of, with :func:`groups`.
    """

    def touches(z: Array) -> tuple[Touch]:
        own = float(parameters.values(PRESS_CONTRAST, z)[number])
        size = max(parameters.one(STRENGTH, z) * float(np.exp(own)), 2.0 * MIN_LOG_CONTRAST)
        at = xy_mm + parameters.values(SHIFT, z) + parameters.values(PLACE, z)[2 * number : 2 * number + 2]
        shape = stamp.at(at, parameters.one(GROWTH, z))
        border = min(max(parameters.one(BORDER, z), MIN_BORDER_MM), shape.width_mm)
        return (Touch((shape,), contrast=float(np.exp(way * size)), border_mm=border),)

    return touches


def own_parameters(parameters: Parameters, number: int) -> list[int]:
    """Return which parameters one press depends on."""
    slices = parameters.slices
    shared = [one for name in (STRENGTH, GROWTH, BORDER, SHIFT) for one in range(slices[name].start, slices[name].stop)]
    place = slices[PLACE].start + 2 * number
    return [*shared, slices[PRESS_CONTRAST].start + number, place, place + 1]
