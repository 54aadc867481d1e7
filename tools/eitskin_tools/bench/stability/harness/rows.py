"""A sweep's curve, and the row of the table that it becomes.

A sweep goes from mild to harsh. Its accuracy is compared with the unstressed one, a_0 (mean correlation with the truth;
for the gate the share of right verdicts)::

    degrades    where the accuracy first falls below 0.9 a_0, interpolated between the levels on either side
    breaks      where it first falls below 0.5 a_0 (gate: 0.5, a coin's), or where half of the frames are withheld
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

Row = dict[str, Any]
"""One line of the table: text and numbers, nothing nested."""

DEGRADED: Final = 0.9
"""Share of the unstressed accuracy below which a sweep has degraded."""

BROKEN: Final = 0.5
"""Share of the unstressed accuracy below which a sweep is broken, and of withheld frames above which it is."""

BREAK_RULE: Final = "accuracy under half of the unstressed one, or half of the frames withheld"
"""In words, for the table."""


@dataclass(frozen=True, slots=True)
class Point:
    """One level of a sweep."""

    level: float
    accuracy: float
    """Mean correlation with the truth of the maps that were shown; the gate's share of right verdicts."""
    map_rms: float
    """Root mean square difference from the unstressed maps, over all pixels of all shown maps."""
    withheld: float = 0.0
    """Share of the frames that were not shown."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One sweep of one solver."""

    sweep: str
    solver: str
    unit: str
    unstressed: float
    """Accuracy without the disturbance."""
    points: tuple[Point, ...]
    """From mild to harsh."""
    logarithmic: bool
    """Levels are interpolated by their logarithm."""

    def degrades_at(self) -> float | None:
        """Return the level at which the accuracy has fallen by a tenth, None where it never does."""
        return crossing(self._levels(), [p.accuracy for p in self.points], DEGRADED * self.unstressed, self.logarithmic)

    def breaks_at(self) -> float | None:
        """Return the level at which the accuracy has halved, or half of the frames are withheld; None if never."""
        wrong = crossing(self._levels(), [p.accuracy for p in self.points], BROKEN * self.unstressed, self.logarithmic)
        shown = crossing(self._levels(), [1.0 - p.withheld for p in self.points], BROKEN, self.logarithmic)
        found = [level for level in (wrong, shown) if level is not None]
        harsher = -1.0 if self.points[-1].level < self.points[0].level else 1.0
        return min(found, key=lambda level: harsher * level) if found else None

    def _levels(self) -> list[float]:
        return [point.level for point in self.points]

    def row(self, why: str, frames: int) -> Row:
        """Return the line of the table.

        Args:
            why: What explains the break point, with the figure that does.
            frames: Maps that were shown.
        """
        worst = min(self.points, key=lambda point: point.accuracy)
        return {
            "sweep": self.sweep,
            "solver": self.solver,
            "unit": self.unit,
            "from": self.points[0].level,
            "to": self.points[-1].level,
            "unstressed": rounded(self.unstressed),
            "worst": rounded(worst.accuracy),
            "worst_at": worst.level,
            "map_rms_worst": rounded(max(point.map_rms for point in self.points)),
            "withheld_worst": rounded(max(point.withheld for point in self.points)),
            "degrades_10pct_at": rounded(self.degrades_at()),
            "breaks_at": rounded(self.breaks_at()),
            "break_rule": BREAK_RULE,
            "why": why,
            "frames": frames,
        }


def rounded(value: float | None, digits: int = 4) -> float | None:
    """Return a number with a few significant digits; None for none, and for what is not finite."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{digits}g}")


def crossing(levels: Sequence[float], values: Sequence[float], threshold: float, logarithmic: bool) -> float | None:
    """Return the level at which values first fall below a threshold, None where they never do.

    Between two levels both are taken as straight, the level by its logarithm if asked for; a first level that is below
    already is returned as it is. Values that are not numbers are below any threshold.
    """
    axis = [math.log(level) if logarithmic else level for level in levels]
    before: tuple[float, float] | None = None
    for at, value in zip(axis, values, strict=True):
        if not value >= threshold:
            if before is None or not math.isfinite(value):
                found = at
            else:
                share = (before[1] - threshold) / (before[1] - value)
                found = before[0] + share * (at - before[0])
            return math.exp(found) if logarithmic else found
        before = (at, value)
    return None
