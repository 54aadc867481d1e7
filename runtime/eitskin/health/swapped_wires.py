"""Two wires exchanged: nearly every row of the right wiring is a sum of rows of the wrong one.

Pair p of the device reads electrodes q(p) and q(p + 1), where q exchanges two numbers. The voltage between electrodes p
and p + 1 is therefore a sum of device pairs along the ring, the shorter way round, and so is its drive::

    V(k, m) = sum over i, j of A[k, i] A[m, j] V_device(i, j),     A[p] = pairs from q(p) to q(p + 1), with sign

Rows that need a pair with itself or with its neighbour were never measured and stay missing: one row of 104 for
neighbours. No touch does this to a sheet, so it can be detected and undone while the stream goes on.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS, TABLE

Array = npt.NDArray[np.float64]


_HELD: Final = (TABLE[:, 0] * N_ELECTRODES + TABLE[:, 1], TABLE[:, 1] * N_ELECTRODES + TABLE[:, 0])
"""(104,) each: drive i and measure j as 16 i + j, and the reverse, which a row holds both of."""

_NEVER: Final = np.setdiff1d(np.arange(N_ELECTRODES**2), np.concatenate(_HELD))
"""What no row holds: a pair with itself or with a neighbour."""


@dataclass(frozen=True, slots=True, eq=False)
class Rewiring:
    """The inverse of an exchange of two wires."""

    electrodes: tuple[int, int]
    matrix: Array
    """(104, 104) from the rows as measured to those of the right wiring, in V; missing rows are 0."""
    missing: npt.NDArray[np.bool_]
    """(104,) rows that were not measured."""


def rewiring(first: int, second: int) -> Rewiring:
    """Return the inverse of an exchange of the wires of two electrodes.

    Raises:
        ValueError: They are the same, or do not exist.
    """
    if first == second or not (0 <= first < N_ELECTRODES and 0 <= second < N_ELECTRODES):
        raise ValueError(f"electrodes {first} and {second}; expected two different ones from 0 to {N_ELECTRODES - 1}")
    pairs = _pairs(first, second)
    needed = (pairs[TABLE[:, 0], :, None] * pairs[TABLE[:, 1], None, :]).reshape(N_ROWS, -1)  # (104, 16 * 16)
    missing = (needed[:, _NEVER] != 0.0).any(axis=1)
    matrix = needed[:, _HELD[0]] + needed[:, _HELD[1]]
    matrix[missing] = 0.0
    return Rewiring((first, second), matrix, missing)


def _pairs(first: int, second: int) -> Array:
    """Return (16, 16) A: each true pair as a sum of device pairs."""
    order = np.arange(N_ELECTRODES)
    order[[first, second]] = order[[second, first]]
    pairs = np.zeros((N_ELECTRODES, N_ELECTRODES))
    for pair in range(N_ELECTRODES):
        start, stop = int(order[pair]), int(order[(pair + 1) % N_ELECTRODES])
        steps = (stop - start) % N_ELECTRODES
        forward = steps <= N_ELECTRODES // 2
        begin, count = (start, steps) if forward else (stop, N_ELECTRODES - steps)
        pairs[pair, (begin + np.arange(count)) % N_ELECTRODES] = 1.0 if forward else -1.0
    return pairs
