"""What an attack reports, and how hard it tries."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Effort:
    """How hard an attack tries: ``make test`` takes the short form, ``make attack`` the long one."""

    long: bool = False
    seed: int = 0

    def count(self, short: int, long: int) -> int:
        """Return how often to try."""
        return long if self.long else short


@dataclass
class Outcome:
    """One attack: how often it tried, how often the defence held."""

    attack: str
    tried: int = 0
    withstood: int = 0
    frames_lost: int = 0
    """By honest subscribers meanwhile, where nothing physical was taken from them."""
    figures: dict[str, Any] = field(default_factory=dict)
    broken: list[str] = field(default_factory=list)
    """What did not hold, each with the seed that shows it again; the first twenty."""

    def note(self, held: bool, what: str) -> None:
        """Count one try; ``what`` says how to see it again."""
        self.tried += 1
        self.withstood += held
        if not held and len(self.broken) < 20:
            self.broken.append(what)

    @property
    def held(self) -> bool:
        """Whether it was tried, withstood every time, and cost nobody a frame."""
        return self.tried > 0 and self.withstood == self.tried and self.frames_lost == 0

    def as_dict(self) -> dict[str, Any]:
        """Return it for one JSON object."""
        return asdict(self)


Attack = Callable[[Effort], Outcome]
