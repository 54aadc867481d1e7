"""The second, predicted reference: the forward model's voltages of the bent, untouched sheet.

From a cloud the forward model predicts the untouched voltages of the deformed sheet. The head sees their logarithm
against the flat sheet and subtracts it from that of the measurement, which leaves the effect of the touch. The
prediction is made where the cloud is made; the runtime has no forward model.
"""

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.normalise import RATIO_FLOOR, log_prediction, prediction_ratio
from eitskin_proto.sensor.table import N_ROWS


def check_voltages(name: str, voltages: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return (104,) V as float64, or say what is wrong with them.

    Args:
        name: Their name in messages.
        voltages: (104,) V.

    Raises:
        ValueError: The shape is wrong or a value is not finite; with the value and the bound.
    """
    values = np.asarray(voltages, dtype=np.float64)
    if values.shape != (N_ROWS,):
        raise ValueError(f"{name} voltages have shape {values.shape}, expected ({N_ROWS},)")
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise ValueError(f"{name}[{bad[0]}] is {values[bad[0]]}, expected a finite number of volts")
    return values


def log_ratio(predicted: npt.ArrayLike, reference: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Return (104,) log |V_pred| / |V0|, cut off below at log 1e-3, and 0 where the reference is 0.

    Args:
        predicted: (104,) V, untouched, of the deformed sheet, by the forward model.
        reference: (104,) V, untouched, of the flat sheet: the model's own, or the captured one.

    Raises:
        ValueError: A shape is wrong, or a predicted voltage is not finite.
    """
    numerator, denominator = check_voltages("predicted", predicted), check_voltages("reference", reference)
    ratio = prediction_ratio(numerator, denominator)
    if float(ratio.max(initial=0.0)) > 1 / RATIO_FLOOR:
        worst = int(np.argmax(ratio))
        raise ValueError(
            f"predicted[{worst}] is {ratio[worst]:.3g} times the reference, expected at most {1 / RATIO_FLOOR:.0f}; "
            "give both for the same current"
        )
    return log_prediction(numerator, denominator)
