"""A sheet for the device: the rows of the table and what they read, from SPEC.md and the sheet's measures alone.

A grid of equal resistors stands for 150 x 100 mm of gel; one dense solution for 16 currents gives all rows. That is
coarse (a few percent), yet it is a sheet: a touch lowers what flows below it, and the rows around change as they do.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

ELECTRODES: Final = 16
WIDTH_MM: Final = 150.0
HEIGHT_MM: Final = 100.0
COLUMNS: Final = 45
ROWS: Final = 30
SHEET_OHM: Final = 1000.0
CURRENT_A: Final = 1e-3

Array = npt.NDArray[np.float64]


def table(full: bool = False) -> list[tuple[int, int]]:
    """Return (drive, measured pair) of every row: 104, or 208 of the full table."""
    rows = [(k, (k + step) % ELECTRODES) for k in range(ELECTRODES) for step in range(2, 15)]
    return rows if full else [(k, m) for k, m in rows if k < m]


def rows_of(drives: int, full: bool = False) -> list[int]:
    """Return the numbers of the rows that a scan of some drives has."""
    return [row for row, (drive, _) in enumerate(table(full)) if drives >> drive & 1]


def place(electrode: int) -> tuple[float, float]:
    """Return where an electrode's centre is, (x, y) in mm."""
    along = 12.5 + 31.25 * electrode
    for x, y, dx, dy, length in (
        (0.0, 0.0, 1, 0, WIDTH_MM),
        (WIDTH_MM, 0.0, 0, 1, HEIGHT_MM),
        (WIDTH_MM, HEIGHT_MM, -1, 0, WIDTH_MM),
        (0.0, HEIGHT_MM, 0, -1, HEIGHT_MM),
    ):
        if along < length:
            return x + dx * along, y + dy * along
        along -= length
    raise ValueError(f"electrode {electrode}")


def voltages(touch_mm: tuple[float, float] | None = None, radius_mm: float = 10.0, factor: float = 0.1) -> Array:
    """Return what all 208 rows read, in V; below a touch (x, y) the sheet conducts ``factor`` times as well."""
    step = WIDTH_MM / COLUMNS
    x, y = (np.arange(COLUMNS) + 0.5) * step, (np.arange(ROWS) + 0.5) * step
    conducts = np.full((ROWS, COLUMNS), 1.0 / SHEET_OHM)
    if touch_mm is not None:
        conducts[(x[None] - touch_mm[0]) ** 2 + (y[:, None] - touch_mm[1]) ** 2 < radius_mm**2] *= factor
    node = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    matrix = np.zeros((node.size, node.size))
    for one, other in ((node[:, :-1], node[:, 1:]), (node[:-1], node[1:])):
        a, b = one.ravel(), other.ravel()
        between = 2 / (1 / conducts.ravel()[a] + 1 / conducts.ravel()[b])
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            np.add.at(matrix, (i, j), sign * between)
    shares = np.zeros((node.size, ELECTRODES))
    for electrode in range(ELECTRODES):
        at_x, at_y = place(electrode)
        near = np.maximum(0, 1 - np.abs(x - at_x) / step)[None] * np.maximum(0, 1 - np.abs(y - at_y) / step)[:, None]
        shares[:, electrode] = near.ravel() / near.sum()
    currents = CURRENT_A * (shares - np.roll(shares, -1, axis=1))
    matrix[0, 0] += 1.0 / SHEET_OHM  # ground somewhere; only differences count
    at_electrodes = shares.T @ np.linalg.solve(matrix, currents)  # (16, 16) V: electrode, drive
    pairs = at_electrodes - np.roll(at_electrodes, -1, axis=0)  # (16, 16): pair (m, m + 1), drive
    found: Array = np.array([pairs[m, k] for k, m in table(full=True)])
    return found
