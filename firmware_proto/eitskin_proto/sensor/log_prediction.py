"""log |V_pred| / |V0|: how a network's head is told what the bent sheet would read when nothing touches it.

V_pred and V0 are of one model, or V0 of the device that V_pred was scaled to; what the two have in common drops out.
The ratio is cut off below before its logarithm. Both voltages are free of noise, and no deformation takes a row near to
zero: the smallest ratio of 1000 draws of the families A, B and a wider one is 0.17. So no sensible prediction ever
reaches the floor; it only keeps a logarithm finite. The floors of *measured* ratios protect from other things::

    1e-3   V_pred / V0, here                        finite whatever is sent
    1e-2   V / V0 in the network's features         a strong touch takes a row to 5e-4, noise takes it through zero
    1e-2   V / V0 in the Gaussian of the rows       likewise; and 8 above
    5e-2   V / V0 in the gate                       likewise; it must tell small touches, which are far above
"""

from typing import Final

import numpy as np
import numpy.typing as npt

RATIO_FLOOR: Final = 1e-3
"""|V_pred| / |V0| is not taken for less; its inverse is the largest ratio that the runtime accepts."""


def prediction_ratio(predicted: npt.NDArray[np.float64], reference: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return |V_pred| / |V0|, and 1 in the rows whose reference is 0.

    Args:
        predicted: (..., rows) V of the untouched, deformed sheet.
        reference: (rows,) V of the untouched, flat sheet.
    """
    usable = reference != 0.0
    with np.errstate(over="ignore", under="ignore"):  # an infinite ratio shows by its size
        ratio = np.abs(predicted) / np.abs(np.where(usable, reference, 1.0))
    return np.where(usable, ratio, 1.0)


def log_prediction(predicted: npt.NDArray[np.float64], reference: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Return log |V_pred| / |V0|, cut off below at log ``RATIO_FLOOR``, and 0 in the rows whose reference is 0.

    Args:
        predicted: (..., rows) V of the untouched, deformed sheet.
        reference: (rows,) V of the untouched, flat sheet.
    """
    return np.asarray(np.log(np.maximum(prediction_ratio(predicted, reference), RATIO_FLOOR)), dtype=np.float32)
