"""The rows of a frame: those of the table, or of the full table, whose drive was scanned.

A frame names its drives as 16 bits, bit k for drive k. All of them give 104 or 208 rows; an idle scan gives the rows
of a few drives, in the order of the table, so that a subset is never mistaken for something else.
"""

from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import FULL_TABLE, N_ROWS, RECIPROCAL_IN_FULL, ROW_IN_FULL

ALL_DRIVES: Final = 0xFFFF
"""Drives 0 to 15."""

_TABLE_ROW = np.empty(len(FULL_TABLE), dtype=np.intp)
_TABLE_ROW[ROW_IN_FULL] = np.arange(N_ROWS)
_TABLE_ROW[RECIPROCAL_IN_FULL] = np.arange(N_ROWS)

TABLE_ROW_OF_FULL: Final[npt.NDArray[np.intp]] = _TABLE_ROW
"""(208,) the row of the 104 that each row of the full table equals by reciprocity."""
TABLE_ROW_OF_FULL.setflags(write=False)


@lru_cache(maxsize=64)
def full_rows(full: bool, drives: int) -> npt.NDArray[np.intp]:
    """Return (rows,) index of each row of a frame in the full table.

    Args:
        full: The frame scans the full table, not only the rows with drive < measure.
        drives: 16 bits, bit k for drive k.
    """
    candidates = np.arange(len(FULL_TABLE)) if full else ROW_IN_FULL
    scanned = (drives >> FULL_TABLE[candidates, 0].astype(np.intp)) & 1
    rows = np.asarray(candidates[scanned == 1], dtype=np.intp)
    rows.setflags(write=False)
    return rows


@lru_cache(maxsize=64)
def table_rows(full: bool, drives: int) -> npt.NDArray[np.intp]:
    """Return (rows,) the row of the 104 that each row of a frame measures, directly or by reciprocity."""
    rows = TABLE_ROW_OF_FULL[full_rows(full, drives)]
    rows.setflags(write=False)
    return rows


@lru_cache(maxsize=256)
def row_count(full: bool, drives: int) -> int:
    """Return how many rows a frame with these drives has."""
    return len(full_rows(full, drives))


def drive_count(full: bool, drives: int) -> int:
    """Return how many of these drives have at least one row, which is what a scan takes time for."""
    return len(set(FULL_TABLE[full_rows(full, drives), 0].tolist()))


def drives_from_list(drives: list[int]) -> int:
    """Return the 16 bits of a list of drives.

    Raises:
        ValueError: A drive is not 0 to 15, or stands twice.
    """
    mask = 0
    for drive in drives:
        if not 0 <= drive < 16:
            raise ValueError(f"drive {drive} does not exist; drives are 0 to 15")
        if mask >> drive & 1:
            raise ValueError(f"drive {drive} is in the list twice")
        mask |= 1 << drive
    return mask


def drives_to_list(drives: int) -> list[int]:
    """Return the drives that 16 bits name, ascending."""
    return [drive for drive in range(16) if drives >> drive & 1]
