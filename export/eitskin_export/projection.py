"""Tikhonov on the flat sheet as one matrix: a map is one product away from 104 changes.

The pixels' conductivities answer dV by x = J^T (J J^T + tau I)^-1 dV, with J = d(dV)/d(sigma) on the flat, untouched
sheet and tau relative to the largest eigenvalue of J J^T. It is built in float64 and rounded once: in float32 the
matrix is off by 0.3 % at tau = 1e-5 and by a third at 1e-7. This is the fallback of the frame loop, not the solver
that is compared with: a bent sheet has its own matrix.
"""

from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import Skin
from eitskin_sim.fem.jacobian import cell_jacobian
from eitskin_sim.scene.nominal import flat_metric_of, nominal_electrodes, nominal_sheet

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
    J = np.asarray(jacobian, dtype=np.float64)
    gram = J @ J.T
    tau = factor * float(np.linalg.eigvalsh(gram)[-1])
    return np.asarray(np.linalg.solve(gram + tau * np.eye(N_ROWS), J).T, dtype=np.float32)


def damped_inverse(jacobian: npt.NDArray[np.float64], factor: float = FACTOR) -> npt.NDArray[np.float64]:
    """Return (104, 104) K = (J J^T + tau I)^-1, all that taking rows out of the projection again needs."""
    J = np.asarray(jacobian, dtype=np.float64)
    gram = J @ J.T
    tau = factor * float(np.linalg.eigvalsh(gram)[-1])
    return np.asarray(np.linalg.inv(gram + tau * np.eye(N_ROWS)))


@lru_cache(maxsize=4)
def flat_jacobian(skin: Skin) -> npt.NDArray[np.float64]:
    """Return the (104, pixels) relative Jacobian of a skin's flat sheet, as it is stated."""
    sheet = nominal_sheet(skin)
    untouched, slope = cell_jacobian(sheet, nominal_electrodes(skin), flat_metric_of(skin), shape=skin.grid.shape)
    return np.asarray(slope * sheet.conductivity_S_per_m / untouched[:, np.newaxis])


def flat_projection(skin: Skin, factor: float = FACTOR) -> npt.NDArray[np.float32]:
    """Return the (pixels, 104) projection on a skin's flat sheet."""
    return tikhonov(flat_jacobian(skin), factor)
