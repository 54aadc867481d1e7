"""l1: few touched cells, by FISTA on the factorised operator, with the bounds of an effective contrast.

    x = argmin 1/2 ||A x - d||^2 + lambda sum(x),   0 <= x <= upper,   lambda = factor * max |A^T d|

Only products with A and its transpose are taken, never A^T A: 1350 cells cost 0.3 Mflop a step instead of 3.6. The
steps are those of Beck and Teboulle (SIAM J. Imaging Sci. 2, 2009); momentum is dropped whenever it points uphill
(O'Donoghue and Candes, 2015), without which it oscillates on a matrix with a condition of 1e9.
"""

from typing import Final

import numpy as np

from eitskin_sim.arrays import Array

FACTOR: Final = 0.01
"""Regularisation, relative to the one that leaves nothing; best of 0.03, 0.01 and the paper's 0.001 on random sets."""

ITERATIONS: Final = 400
"""Paper section V.B."""


def l1_image(
    operator: Array,
    data: Array,
    *,
    factor: float = FACTOR,
    upper: float = np.inf,
    iterations: int = ITERATIONS,
) -> Array:
    """Return the (n,) non-negative, sparse minimiser.

    Args:
        operator: (rows, n) A.
        data: (rows,) d.
        factor: Regularisation, relative to max |A^T d|: at 1 the image is empty.
        upper: Largest value of a cell.
        iterations: Steps.

    Raises:
        ValueError: The factor is negative, or the upper bound not positive.
    """
    if not factor >= 0.0 or not upper > 0.0:
        raise ValueError(f"factor must be at least 0 and upper above 0, found {factor} and {upper}")
    step = 1.0 / float(np.linalg.norm(operator @ operator.T, 2))
    penalty = factor * float(np.abs(operator.T @ data).max(initial=0.0))
    image = np.zeros(operator.shape[1])
    ahead, momentum = image, 1.0
    for _ in range(iterations):
        slope = operator.T @ (operator @ ahead - data) + penalty
        new = np.clip(ahead - step * slope, 0.0, upper)
        if float(np.vdot(ahead - new, new - image)) > 0.0:
            momentum = 1.0
        faster = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum**2))
        ahead = new + (momentum - 1.0) / faster * (new - image)
        image, momentum = new, faster
    return image
