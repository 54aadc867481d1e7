"""Counts every map that a stressed pipeline publishes, and those that it must never publish."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclass(slots=True)
class Tally:
    """What came out of the pipelines of one run."""

    published: int = 0
    """Maps."""
    not_finite: int = 0
    """Maps with a value that is NaN or infinite."""
    out_of_range: int = 0
    """Maps with a value below 0 or above 1."""
    withheld: Counter[str] = field(default_factory=Counter)
    """Frames that were not published, by reason."""
    refused: Counter[str] = field(default_factory=Counter)
    """Inputs that were refused before any frame, by the exception's name."""
    escaped: list[str] = field(default_factory=list)
    """Inputs that ended in an exception which is no refusal: defects."""
    unmarked: int = 0
    """Published maps of frames whose rows were cut off and that do not say so."""

    def take(self, image: npt.NDArray[np.floating]) -> None:
        """Count a published map, of any shape."""
        self.published += 1
        low, high = float(np.min(image)), float(np.max(image))  # both NaN if any value is
        if not (np.isfinite(low) and np.isfinite(high)):
            self.not_finite += 1
        elif low < 0.0 or high > 1.0:
            self.out_of_range += 1

    def summary(self) -> dict[str, Any]:
        """Return the counts as one flat object."""
        return {
            "published": self.published,
            "published_not_finite": self.not_finite,
            "published_out_of_range": self.out_of_range,
            "published_saturated_unmarked": self.unmarked,
            "withheld": sum(self.withheld.values()),
            **{f"withheld_{reason}": count for reason, count in sorted(self.withheld.items())},
            "refused": sum(self.refused.values()),
            "escaped": len(self.escaped),
        }
