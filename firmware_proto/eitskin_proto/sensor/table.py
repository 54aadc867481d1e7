"""The adjacent-drive protocol: the electrodes that carry current, the measured pairs, and their order.

Electrodes are numbered 0 to 15, counter-clockwise from the corner (0, 0). Drive k sends the current into electrode k
and out of electrode k + 1; measure m reads V = U[m] - U[m + 1]; all indices are modulo 16. A pair that shares an
electrode with the drive is not measured, which leaves m = k + 2 .. k + 14: 16 x 13 = 208 rows. Reciprocity makes row
(k, m) equal to row (m, k), so the 104 rows with k < m have all information (paper sections V.A and VI.A). ::

    full table, 208 rows       (0,2) (0,3) ... (0,14) | (1,3) ... (1,15) | (2,4) ... (2,15) (2,0) | ...
    table, 104 rows            the rows of the full table with k < m, in the same order

EIDORS and pyEIT use the same order and the opposite sign, which the normalisation (V - V0) / V0 cancels.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

N_ELECTRODES: Final = 16
"""Electrodes on the border (paper section III)."""


def _full_table() -> npt.NDArray[np.uint8]:
    rows = [(k, (k + step) % N_ELECTRODES) for k in range(N_ELECTRODES) for step in range(2, N_ELECTRODES - 1)]
    return np.array(rows, dtype=np.uint8)


def _frozen(array: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    array.setflags(write=False)
    return array


FULL_TABLE: Final[npt.NDArray[np.uint8]] = _full_table()
"""(208, 2), drive and measure of every row of a full scan."""

ROW_IN_FULL: Final[npt.NDArray[np.intp]] = np.flatnonzero(FULL_TABLE[:, 0] < FULL_TABLE[:, 1])
"""(104,), index of each row of ``TABLE`` in ``FULL_TABLE``."""

TABLE: Final[npt.NDArray[np.uint8]] = FULL_TABLE[ROW_IN_FULL]
"""(104, 2), drive and measure of every row of a frame."""


def _reciprocal() -> npt.NDArray[np.intp]:
    where = {(int(k), int(m)): row for row, (k, m) in enumerate(FULL_TABLE)}
    return np.array([where[int(m), int(k)] for k, m in TABLE], dtype=np.intp)


RECIPROCAL_IN_FULL: Final[npt.NDArray[np.intp]] = _reciprocal()
"""(104,), index of the reciprocal (m, k) of each row of ``TABLE`` in ``FULL_TABLE``."""

N_ROWS: Final = len(TABLE)
"""Rows of a frame (paper section V.A)."""

N_FULL_ROWS: Final = len(FULL_TABLE)
"""Rows of a full scan, with the reciprocal half."""

for _array in (FULL_TABLE, ROW_IN_FULL, TABLE, RECIPROCAL_IN_FULL):
    _frozen(_array)


def voltages_from_potentials(
    potentials: npt.NDArray[np.float64], table: npt.NDArray[np.uint8] = TABLE
) -> npt.NDArray[np.float64]:
    """Return the voltages of every row of a table.

    Args:
        potentials: (..., 16 drives, 16 electrodes) V, the electrode potentials under each drive.
        table: (rows, 2) drive and measure of each row.

    Returns:
        (..., rows) V.
    """
    drive = table[:, 0].astype(np.intp)
    measure = table[:, 1].astype(np.intp)
    return potentials[..., drive, measure] - potentials[..., drive, (measure + 1) % N_ELECTRODES]
