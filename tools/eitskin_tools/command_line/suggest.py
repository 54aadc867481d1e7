"""The name that was probably meant: ``bech`` is near ``bench``."""

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Final

NEAR: Final = 0.65
"""Share of letters that a name must have in common with what was found; ``file`` has 0.6 of ``single``."""


def did_you_mean(word: str, names: Iterable[str]) -> str:
    """Return ``; did you mean 'bench'?`` for the nearest name, and nothing where none is near.

    Args:
        word: What was found.
        names: What there is.
    """
    listed = list(names)
    by_lower = {name.lower(): name for name in listed}
    near = get_close_matches(word.lower(), by_lower, n=1, cutoff=NEAR)
    return f"; did you mean {by_lower[near[0]]!r}?" if near else ""


def expected_one_of(what: str, word: str, names: Iterable[str]) -> str:
    """Return ``--solver is 'vd2'; expected one of vd2t, tikhonov; did you mean 'vd2t'?``."""
    listed = list(names)
    return f"{what} is {word!r}, expected one of {', '.join(listed)}{did_you_mean(word, listed)}"
