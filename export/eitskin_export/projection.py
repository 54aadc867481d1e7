"""Tikhonov on the flat sheet as one matrix: a map is one product away from 104 changes.

The pixels' conductivities answer dV by x = J^T (J J^T + tau I)^-1 dV, with J = d(dV)/d(sigma) on the flat, untouched
sheet and tau relative to the largest eigenvalue of J J^T. It is built in float64 and rounded once: in float32 the
matrix is off by 0.3 % at tau = 1e-5 and by a third at 1e-7. This is the fallback of the frame loop, not the solver
that is compared with: a bent sheet has its own matrix.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ROWS

FACTOR: Final = 1e-3
"""Tikhonov's factor (paper section V.B), relative to the largest eigenvalue of J J^T."""


def tikhonov(jacobian: npt.NDArray[np.float64], factor: float = FACTOR) -> npt.NDArray[np.float32]:
    """Return the (pixels, 104) projection of a Jacobian.

    Args:
        jacobian: (104, pixels) relative change of each row per relative change of each pixel.
        factor: Regularisation, relative.

    Raises:
        ValueError: The factor is not positive.
    """
    if not factor > 0.0:
        raise ValueError(f"factor is {factor}; expected more than 0")
    return np.asarray(np.linalg.solve(_damped(jacobian, factor), jacobian).T, dtype=np.float32)


def damped_inverse(jacobian: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return (104, 104) K = (J J^T + tau I)^-1, all that taking rows out of the projection again needs."""
    return np.asarray(np.linalg.inv(_damped(jacobian, FACTOR)))


def _damped(J: npt.NDArray[np.float64], factor: float) -> npt.NDArray[np.float64]:
    """Return (104, 104) J J^T + tau I."""
    gram = J @ J.T
    return np.asarray(gram + factor * float(np.linalg.eigvalsh(gram)[-1]) * np.eye(N_ROWS))
