"""What a verifier says of one frame: the touches, how well they explain it, and what was fitted along."""

from dataclasses import dataclass
from typing import Generic, TypeVar

Touch = TypeVar("Touch")
"""What one touch is: a unit with its contrast, or a shape."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """A nuisance that was fitted along."""

    name: str
    value: float
    """In the nuisance's own unit: parts of conductivity, gauge factor, amplitude of stretch."""
    error: float
    """Its standard error."""


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
    nuisances: tuple[Fitted, ...] = ()
    unfinished: bool = False
    """Whether time ended the search before these explained the frame, or were confirmed."""

    @property
    def flagged(self) -> bool:
        """Whether physics cannot explain the frame by these touches."""
        return self.p_value < self.level
