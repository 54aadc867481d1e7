"""Classical solvers without some rows: precomputed operators corrected in a millisecond, not built anew.

Tikhonov's matrix is M = W^-2 A^T K with K = (A W^-2 A^T + lambda I)^-1. Let rows m go and rows o stay. By the inverse
of a block matrix the inverse of what is left of A W^-2 A^T + lambda I is K_oo - K_om K_mm^-1 K_mo, so that

    M' = M_:o - M_:m K_mm^-1 K_mo

which is the matrix of the rows that are left, with the weights W and the damping lambda of all rows: what a missing
electrode must not do is change what the image is regularised by. It also equals filling the missing data in by
d_m = -K_mm^-1 K_mo d_o. l1 needs A_o and the largest eigenvalue of A_o A_o^T, a part of a matrix that is kept; SBL
needs A_o alone, for everything else of it depends on the data.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import linalg

from eitskin_sim.solvers.operators import Operators
from eitskin_sim.solvers.tikhonov import FACTOR, SENSITIVITY_POWER, weighed

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Precomputed:
    """What is kept of one bend, so that any rows can go."""

    operators: Operators
    matrix: Array
    """(n, rows) Tikhonov's M."""
    inverse: Array
    """(rows, rows) K."""
    gram: Array
    """(rows, rows) A A^T."""

    def tikhonov(self, gone: Rows) -> Array:
        """Return the (n, rows left) Tikhonov matrix without some rows."""
        left, missing = np.flatnonzero(~gone), np.flatnonzero(gone)
        if not len(missing):
            return self.matrix.copy()
        inner = linalg.cho_factor(self.inverse[np.ix_(missing, missing)])
        back = linalg.cho_solve(inner, self.inverse[np.ix_(missing, left)])
        return np.asarray(self.matrix[:, left] - self.matrix[:, missing] @ back)

    def left(self, gone: Rows) -> tuple[Array, float]:
        """Return the (rows left, n) operator and its largest squared singular value: what l1 and SBL take."""
        part = np.flatnonzero(~gone)
        largest = linalg.eigvalsh(self.gram[np.ix_(part, part)], subset_by_index=[len(part) - 1, len(part) - 1])
        return self.operators.relative_jacobian[part], float(largest[0])


def precompute(operators: Operators) -> Precomputed:
    """Return what is kept of one bend, by the usual regularisation."""
    operator = operators.relative_jacobian
    weight, scaled, damped = weighed(operator, FACTOR, SENSITIVITY_POWER)
    inverse = np.asarray(linalg.cho_solve(linalg.cho_factor(damped), np.eye(len(damped))))
    inverse = (inverse + inverse.T) / 2.0
    return Precomputed(operators, np.asarray((inverse @ scaled / weight).T), inverse, operator @ operator.T)
