"""What physics says of frames that are computed once more: how sure it is, what it contradicts, and what it takes."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class Judged:
    """One frame's verdict."""

    p_value: float
    """Chance of so large a residual if the touches are right."""
    flagged: bool
    """Physics cannot explain the frame by them."""
    ms: float
    """What it took, by the clock."""
    setup_ms: float
    """Making models of its shape, by the processor; 0 where they were there."""


@dataclass(slots=True)
class Verdicts:
    """Counts verdicts, and frames of which there is none."""

    p_values: list[float] = field(default_factory=list)
    flagged: int = 0
    ms: list[float] = field(default_factory=list)
    setup_ms: float = 0.0
    not_verified: Counter[str] = field(default_factory=Counter)
    """Touched frames without a verdict, by why."""

    def add(self, judged: Judged) -> None:
        """Take one frame's."""
        self.p_values.append(judged.p_value)
        self.flagged += judged.flagged
        self.ms.append(judged.ms)
        self.setup_ms += judged.setup_ms

    def fields(self) -> dict[str, Any]:
        """Return plain values; None where no frame was verified."""
        count = len(self.p_values)
        return {
            "frames": count,
            "flagged_share": self.flagged / count if count else None,
            "p_value_median": float(np.median(self.p_values)) if count else None,
            "ms_median": round(float(np.median(self.ms)), 3) if count else None,
            "ms_p95": round(float(np.percentile(self.ms, 95)), 3) if count else None,
            "setup_ms": round(self.setup_ms, 1),
            "not_verified": dict(self.not_verified),
        }
