"""An option that takes several names at once: ``--only noise,inputs``, and as often as one likes."""

import argparse
from collections.abc import Callable, Sequence


def several(names: Sequence[str]) -> Callable[[str], tuple[str, ...]]:
    """Return what reads a list of names, separated by commas, and refuses any other.

    Args:
        names: Those that there are.
    """

    def read(text: str) -> tuple[str, ...]:
        found = tuple(part.strip() for part in text.split(","))
        unknown = [part for part in found if part not in names]
        if unknown:
            raise argparse.ArgumentTypeError(f"{unknown[0]!r} is none of them; expected some of {', '.join(names)}")
        return found

    return read


def chosen(given: Sequence[tuple[str, ...]] | None, names: Sequence[str]) -> tuple[str, ...]:
    """Return the names that were asked for, in their own order; all of them where none was.

    Args:
        given: What ``action="append"`` collected.
        names: Those that there are.
    """
    wanted = {name for part in given or () for name in part}
    return tuple(name for name in names if not wanted or name in wanted)
