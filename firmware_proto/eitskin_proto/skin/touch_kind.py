"""Which way touches change conductance: what a skin's touches do, and what a network knows."""

from collections.abc import Iterable
from typing import Final, Literal, get_args

TouchKind = Literal["raising", "lowering", "both"]
"""Raising as the paper's touches, lowering as a press on a hydrogel, or both ways."""

TOUCH_KINDS: Final[tuple[TouchKind, ...]] = get_args(TouchKind)


def together(kinds: Iterable[TouchKind]) -> TouchKind:
    """Return which way touches of several kinds go, of at least one."""
    found = set(kinds)
    return found.pop() if len(found) == 1 else "both"


def knows(known: TouchKind, wanted: TouchKind) -> bool:
    """Return whether who knows touches of one kind knows all of another."""
    return known in ("both", wanted)
