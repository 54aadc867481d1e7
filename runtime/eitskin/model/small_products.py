"""Splits matrix products into pieces so small that BLAS computes them in the caller's thread.

A threaded BLAS hands larger products to its thread pool and spins until the pool is done. On a busy machine one of its
threads waits for a core meanwhile, and frames wait with it: a third of a second for a product of a millisecond. A
program that hosts a skin may need that pool, so its settings stay, and frames avoid it.

This works from OpenBLAS 0.3.27 on (numpy 2.0). The one in numpy 1.26 uses the pool even for a matrix of 96 rows times a
vector.
"""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

MAX_PRODUCTS: Final = 1 << 17
"""Multiplications of one piece: half of what the most eager OpenBLAS gives to more than one thread."""


def product(left: npt.NDArray[Any], right: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return ``left @ right``.

    Args:
        left: (n, k)
        right: (k, m)
    """
    rows = max(1, MAX_PRODUCTS // max(1, right.size))
    if len(left) <= rows:
        return np.asarray(left @ right)
    out = np.empty((len(left), right.shape[1]), dtype=np.result_type(left, right))
    for start in range(0, len(left), rows):
        np.matmul(left[start : start + rows], right, out=out[start : start + rows])
    return out
