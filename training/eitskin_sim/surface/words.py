"""Points from lines of words, as text files have them."""

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Final

import numpy as np

from eitskin_sim.arrays import Array

MAX_POINTS: Final = 4_000_000
"""A scanner of 0.1 mm sees 1,500,000 on the sheet."""


def table(rows: Iterable[list[bytes]]) -> Array:
    """Return (n, 3) numbers of rows of words, a piece at a time: words take ten times the memory of numbers.

    Raises:
        ValueError: A word is no number, or there are more than ``MAX_POINTS`` rows.
    """
    found: list[Array] = []
    count = 0
    for piece in _pieces(rows):
        count += len(piece)
        check_count(count)
        found.append(np.array([[float(word) for word in row] for row in piece], dtype=np.float64))
    return np.concatenate(found) if found else np.empty((0, 3))


def check_count(count: int) -> None:
    """Raise ValueError if there are more than ``MAX_POINTS``."""
    if count > MAX_POINTS:
        raise ValueError(f"more than {MAX_POINTS} points; scan less densely: 7,000 are enough for a sheet")


def _pieces(rows: Iterable[list[bytes]]) -> Iterator[list[list[bytes]]]:
    left = iter(rows)
    while piece := list(islice(left, 4096)):
        yield piece
