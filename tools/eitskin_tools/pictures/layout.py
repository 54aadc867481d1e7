"""How maps fit on a screen: side by side, one below the other, larger or smaller, and what is left out if they cannot.

The paper's map has 45 x 30 pixels; a character shows one across and two down. Both maps are drawn as large as the
screen allows, whole pixels enlarged where there is room, and averaged over areas where there is not.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

GAP: Final = 4
"""Characters between two maps side by side."""

LEAST_COLUMNS: Final = 24
"""A narrower map shows nothing of a touch any more."""

MOST_TIMES: Final = 4
"""A pixel is enlarged to at most so many characters across."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where maps stand."""

    columns: int
    """Characters across a map."""
    lines: int
    """Lines of a map."""
    arrangement: Literal["beside", "below", "alone"]
    """Where the truth stands, or that there is only one map."""
    left_out: bool = False
    """Whether there is a truth that is not shown."""


def arrange(width: int, height: int, shape: tuple[int, int], *, truth: bool) -> Layout:
    """Return how maps fit.

    Args:
        width: Characters of the screen.
        height: Lines that are left for maps and captions.
        shape: Rows and columns of a map's pixels.
        truth: Whether there are two maps.
    """
    alone = _largest(width, height - 1, shape)
    if not truth:
        return Layout(*alone, "alone")
    beside = _largest((width - GAP) // 2, height - 1, shape)
    below = _largest(width, (height - 2) // 2, shape)
    if max(beside[0], below[0]) < LEAST_COLUMNS:
        return Layout(*alone, "alone", left_out=True)
    return Layout(*below, "below") if below[0] > beside[0] else Layout(*beside, "beside")


def _largest(width: int, lines: int, shape: tuple[int, int]) -> tuple[int, int]:
    """Return (columns, lines) of the largest map in a box, at least 2 by 1."""
    rows, columns = shape
    times = min(width // columns, 2 * lines // (rows + rows % 2), MOST_TIMES)
    if times >= 1:
        return times * columns, -(-times * rows // 2)
    share = min(width / columns, 2 * lines / rows)
    return max(int(share * columns), 2), max(round(share * rows / 2), 1)


def fitted(image: npt.NDArray[np.floating], columns: int, lines: int) -> npt.NDArray[np.float64]:
    """Return a map as (2 lines, columns), each value the mean over the area that it stands for."""
    rows_in, columns_in = image.shape
    return np.asarray(_means(rows_in, 2 * lines) @ image @ _means(columns_in, columns).T, dtype=np.float64)


def _means(size: int, to: int) -> npt.NDArray[np.float64]:
    """Return (to, size) weights that average intervals of one division of a line over those of another."""
    edges_in, edges = np.arange(size + 1) / size, np.arange(to + 1) / to
    shared = np.minimum(edges[1:, None], edges_in[None, 1:]) - np.maximum(edges[:-1, None], edges_in[None, :-1])
    shared = np.maximum(shared, 0.0)
    return np.asarray(shared / shared.sum(axis=1, keepdims=True), dtype=np.float64)
