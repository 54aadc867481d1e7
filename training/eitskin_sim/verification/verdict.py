"""What a verifier says of one frame: the touches, and how well they explain it."""

from dataclasses import dataclass
from typing import Generic, TypeVar

Touch = TypeVar("Touch")
"""What one touch is: a unit with its contrast, or a shape."""


@dataclass(frozen=True, slots=True)
class Verdict(Generic[Touch]):
    """One frame, explained as well as could be in its time."""

    touches: tuple[Touch, ...]
    chi_squared: float
    """Sum of squares of the whitened residual."""
    degrees_of_freedom: int
    """Rows, less what was fitted freely."""
    p_value: float
    """Chance of so large a chi-squared if the touches are right."""
    level: float
    """Below which p is flagged."""
    evaluations: int
    """How many sets of touches were modelled."""
    seconds: float
    """What it took."""
    unfinished: bool = False
    """Whether time ended the search before these explained the frame, or were confirmed."""

    @property
    def flagged(self) -> bool:
        """Whether physics cannot explain the frame by these touches."""
        return self.p_value < self.level
