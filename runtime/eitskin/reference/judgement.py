"""The findings about a reference at its capture."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Judgement:
    """The findings about a reference."""

    median_spread: float
    """Of a single frame's row, relative."""
    movement: float
    """Relative; 0 if nothing but noise was seen, or too few frames to tell."""
    model_difference: float | None
    """Rms of log(V / V_model); None without a model."""
    older_difference: float | None
    """Rms of log(V / V_older); None without an older reference."""
    touched: bool | None
    """The gate's decision against the older reference; None without one, or without a gate."""
    refusals: tuple[str, ...]
    """Reasons to refuse it."""
    remarks: tuple[str, ...]
    """Remarks for people if it is accepted."""

    def fields(self) -> dict[str, object]:
        """Return the findings, for an answer or ``--json``."""
        return {
            "median_spread": self.median_spread,
            "movement": self.movement,
            "model_difference": self.model_difference,
            "older_difference": self.older_difference,
            "touched": self.touched,
            "remarks": [*self.refusals, *self.remarks],
        }
