"""From voltages to relative change, against the one reference taken flat and untouched (paper section II, eq. 2).

dV = (V - V0) / V0, elementwise. The division removes the sign of the drive convention and the current; a conductive
touch then mostly lowers it. |V0| spans a factor of about 500 over the rows, so a row whose reference is lost in noise
would amplify that noise without bound. The rule: a row whose |V0| is under ``WEAK_FRACTION`` of the largest is *weak*,
carries no information, and its dV is 0.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

WEAK_FRACTION: Final = 1e-4
"""A reference row below this fraction of the largest is weak. A healthy sheet's smallest row is at 2e-3."""

RANGE_V: Final = (1e-30, 1e30)
"""The largest row ever measured is well below; above, 1 / V0 would underflow."""


def weak_rows(reference: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """Return which rows of a reference are too weak to divide by.

    Args:
        reference: (rows,) V, untouched and flat.

    Returns:
        (rows,) True where |V0| < WEAK_FRACTION * max |V0|, or where V0 is not finite.

    Raises:
        ValueError: No row is finite and different from zero, or the largest is outside ``RANGE_V``.
    """
    size = np.abs(np.where(np.isfinite(reference), reference, 0.0))
    largest = float(size.max(initial=0.0))
    if largest == 0.0:
        raise ValueError("a reference of zeros cannot normalise frames; expected at least one row with a voltage")
    if not RANGE_V[0] <= largest <= RANGE_V[1]:
        raise ValueError(
            f"the largest reference row is {largest:.3g} V; expected {RANGE_V[0]:g} to {RANGE_V[1]:g} V; is it damaged?"
        )
    return np.asarray(size < WEAK_FRACTION * largest)


def inverse_reference(reference: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Return (rows,) 1 / V0, and 0 in the weak rows, so that normalising is one multiplication."""
    weak = weak_rows(reference)
    return np.asarray(np.where(weak, 0.0, 1.0 / np.where(weak, 1.0, reference)), dtype=np.float64)


def relative_change(voltages: npt.NDArray[np.floating], reference: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Return dV = (V - V0) / V0, and 0 in the weak rows.

    Args:
        voltages: (..., rows) V.
        reference: (rows,) V.

    Returns:
        (..., rows) relative change, without unit.
    """
    inverse = inverse_reference(reference)
    change = voltages * inverse
    change -= inverse != 0.0
    return np.asarray(change, dtype=np.float64)


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
