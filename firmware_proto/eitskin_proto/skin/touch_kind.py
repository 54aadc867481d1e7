"""The direction in which touches change conductance, for a skin's touches and a network's training data.

The same three words are used in a skin's file, a bundle's manifest, the option ``--touches``, robot.toml and the log.
"""

from collections.abc import Iterable
from typing import Final, Literal, get_args

from eitskin_proto.files.plain import quoted

TouchKind = Literal["lower", "raise", "both"]
"""``lower`` as a press on a hydrogel, ``raise`` as the paper's touches, or both ways."""

TOUCH_KINDS: Final[tuple[TouchKind, ...]] = get_args(TouchKind)

EARLIER_WORDS: Final[dict[object, TouchKind]] = {"lowering": "lower", "raising": "raise"}
"""The words of earlier releases."""


def touch_kind_of(found: object) -> TouchKind:
    """Return the kind that a file names, in today's words.

    Raises:
        ValueError: It names none; the text goes on from the key's name.
    """
    word = EARLIER_WORDS.get(found, found) if isinstance(found, str) else found
    if word not in TOUCH_KINDS:
        raise ValueError(f"found {quoted(found)}, expected one of {', '.join(TOUCH_KINDS)}")
    return word


def together(kinds: Iterable[TouchKind]) -> TouchKind:
    """Return which way touches of several kinds go, of at least one."""
    found = set(kinds)
    return found.pop() if len(found) == 1 else "both"


def knows(known: TouchKind, wanted: TouchKind) -> bool:
    """Return whether a network that knows touches of one kind knows all of another."""
    return known in ("both", wanted)
