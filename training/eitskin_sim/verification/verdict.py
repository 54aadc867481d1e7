"""A verifier's verdict on one frame: the touches, their chi-squared, and its p-value.

A right model leaves a chi-squared near its number of degrees of freedom n, give or take sqrt(2 n). The p-value is the
chance that a right model leaves this much or more: among right answers it is uniform, one in a hundred below 0.01.
"""

from dataclasses import dataclass
from typing import Final, Generic, TypeVar

from scipy import special

LEVEL: Final = 0.01
"""A verdict whose p-value is below is flagged."""

Touch = TypeVar("Touch")
"""One touch: a unit with its contrast, or a shape."""


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
    """The time it took."""
    unfinished: bool = False
    """Whether time ended the search before these explained the frame, or were confirmed."""

    on_dented_sheet: bool = False
    """Whether the sheet has a dent in which a scan does not show well enough where its material is."""

    @property
    def flagged(self) -> bool:
        """Whether physics cannot explain the frame by these touches, or knows its sheet too badly."""
        return self.p_value < self.level or self.on_dented_sheet


def p_value(chi_squared: float, degrees_of_freedom: int) -> float:
    """Return the chance of so large a chi-squared or a larger one under a right model (``scipy.stats.chi2.sf``).

    Raises:
        ValueError: There are no degrees of freedom.
    """
    if degrees_of_freedom < 1:
        raise ValueError(f"{degrees_of_freedom} degrees of freedom: the fit has more parameters than rows")
    return float(special.chdtrc(degrees_of_freedom, max(chi_squared, 0.0)))
