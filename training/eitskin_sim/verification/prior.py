"""How likely touches are before anything is measured: what a further one must explain to be believed.

Costs are -2 log of a probability, to be added to a chi-squared. A further touch somewhere costs the logarithm of the
places where it might be, besides what its own chance is; its size is log-normal about what touches are like.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Prior:
    """What touches are like.

    Args:
        places: Where a touch may be: units of a grid, or areas as large as what can be told apart.
        expected: Mean number of touches.
        size_mm: Median of the square root of a touch's area.
        size_log_sd: Standard deviation of its logarithm.
    """

    places: int = 126
    expected: float = 3.0
    size_mm: float = 12.0
    size_log_sd: float = 0.6

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.places < 1 or not (self.expected > 0.0 and self.size_mm > 0.0 and self.size_log_sd > 0.0):
            raise ValueError(f"{self} is no prior: places, touches, sizes and their spread must be above 0")

    @property
    def per_touch(self) -> float:
        """What each touch costs: 2 log(places / expected)."""
        return max(2.0 * log(self.places / self.expected), 0.0)

    def cost(self, count: int, sizes_mm: Sequence[float] | Array = ()) -> float:
        """Return what so many touches cost, and those whose size is free what their sizes do."""
        away = np.log(np.asarray(sizes_mm, dtype=np.float64) / self.size_mm) / self.size_log_sd
        return count * self.per_touch + float(np.sum(np.square(away)))
