"""Tikhonov: one matrix per bend, because the minimiser of a quadratic is linear in the data.

    x = argmin ||A x - d||^2 + lambda ||W x||^2 = W^-2 A^T (A W^-2 A^T + lambda I)^-1 d
    lambda = factor * ||A W^-1||_2^2

W weighs each cell by a power of its sensitivity, the norm of its column: with W = I the image crowds at the
electrodes, where a small change explains much. The right-hand form needs a 104 x 104 inverse whatever the number of
cells.
"""

from typing import Final

import numpy as np
from scipy import linalg

from eitskin_sim.arrays import Array

FACTOR: Final = 1e-4
"""Relative to the largest squared singular value; best of 1e-2 to 1e-5 on random touch sets at ten bends."""

SENSITIVITY_POWER: Final = 0.5
"""W = (norm of the column) ** this; best of 0, 1/2 and 1 on the same sets."""


def tikhonov_matrix(operator: Array, factor: float = FACTOR, sensitivity_power: float = SENSITIVITY_POWER) -> Array:
    """Return the (n, rows) matrix that turns data into an image.

    Args:
        operator: (rows, n) A.
        factor: Regularisation, relative to the largest squared singular value of A W^-1.
        sensitivity_power: 0 penalises all cells alike, 1 penalises them by their sensitivity.

    Raises:
        ValueError: The factor is not positive.
    """
    weight, scaled, damped = weighed(operator, factor, sensitivity_power)
    inner = linalg.cho_solve(linalg.cho_factor(damped), scaled)
    return np.asarray((inner / weight).T)


def weighed(operator: Array, factor: float, sensitivity_power: float) -> tuple[Array, Array, Array]:
    """Return (n,) W, (rows, n) A W^-1 and (rows, rows) A W^-2 A^T + lambda I.

    Raises:
        ValueError: The factor is not positive.
    """
    if not factor > 0.0:
        raise ValueError(f"regularisation factor {factor} must be above 0")
    weight = np.linalg.norm(operator, axis=0) ** sensitivity_power
    scaled = operator / weight
    gram = scaled @ scaled.T
    return weight, scaled, gram + factor * float(linalg.eigvalsh(gram)[-1]) * np.eye(len(gram))
