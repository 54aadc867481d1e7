"""How long a process that ended waits for its next start."""

from dataclasses import dataclass
from typing import Final

FIRST_PAUSE_S: Final = 1.0
"""Before the first new start; twice as long before each further one."""

LONGEST_PAUSE_S: Final = 30.0

SETTLED_S: Final = 60.0
"""Who was ready for so long begins with the first pause again."""


@dataclass(frozen=True, slots=True)
class Pauses:
    """How long a process that ended waits for its next start."""

    first_s: float = FIRST_PAUSE_S
    longest_s: float = LONGEST_PAUSE_S
    settled_s: float = SETTLED_S

    def after(self, failures: int) -> float:
        """Return the pause after so many failures in a row, from 1 on."""
        return float(min(self.first_s * 2.0 ** min(failures - 1, 60), self.longest_s))
