"""What a device boots from its storage, as ``struct eit_host_outcome`` has it."""

from typing import Final, NamedTuple

MOST_OUTCOMES: Final = 32
"""So many different ones are kept between two looks."""


class Outcome(NamedTuple):
    """What a device runs after a boot, and what once every trial is over; generation 0 is what is built in."""

    generation: int
    digest: int
    trial: int
    """1: it runs on trial."""
    settled_generation: int
    settled_digest: int
