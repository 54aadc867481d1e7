"""Checks whether a prediction can belong to the device: V_pred against the flat sheet's voltages.

A prediction in other units, of another table of rows, or of nothing, has 104 finite numbers like any other. Of 810
deformations (the paper's ten, 400 draws each of the families A and B; see :mod:`eitskin_proto.skin.sheet_cloud`) each
row of V_pred / V_flat is 0.22 to 2.8; outside 0.08 to 6 it is refused.

Where the captured reference replaces V_flat, the device's gain and current come in, and its contacts: bounds are then 3
times as wide, and all rows may have the other sign. Where both are given, the model's flat sheet is compared with the
captured one: with a common factor taken out, the median row of an honest device is within 8 % (electrodes placed to 1
mm, contacts from a tenth to ten times the model's), and with another table of rows hundreds of per cent off; more than
``LARGEST_SHAPE`` is refused. The check takes 0.15 ms.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BadReference
from eitskin.reference.captured import Reference
from eitskin.reference.predicted import check_voltages
from eitskin.reference.scanned import DECIMALS, RATIO, ReferenceScan
from eitskin_proto.sensor.normalise import weak_rows
from eitskin_proto.skin.cloud_file import Surface
from eitskin_proto.skin.sheet_cloud import check_sheet
from eitskin_proto.skin.skin import Skin

Array = npt.NDArray[np.float64]

CAPTURED_FACTOR: Final = 3.0
"""How much wider bounds are against a captured reference."""

LARGEST_SHAPE: Final = 0.5
"""Median |log| between the model's flat sheet and the captured one, a common factor taken out."""

PREDICTION_HINT: Final = (
    "give the forward model's V_pred of this cloud and predicted_flat, its own V of the flat sheet, both in V"
)


def check_prediction(
    predicted: npt.ArrayLike, predicted_flat: npt.ArrayLike | None, captured: Reference | None
) -> None:
    """Refuse a prediction that cannot be of this device.

    Args:
        predicted: (104,) V, of the bent sheet, by the forward model.
        predicted_flat: (104,) V, of the flat sheet, by the same model; None takes the captured reference.
        captured: The device's reference; None if there is none.

    Raises:
        ValueError: With what was found, what was expected and what to do.
    """
    found = check_voltages("predicted", predicted)
    model = None if predicted_flat is None else check_voltages("predicted_flat", predicted_flat)
    device = None if captured is None else captured.flat().voltages_V.copy()
    if device is not None and captured is not None:
        device[captured.weak] = 0.0  # what carries nothing is compared with nothing
    against = device if model is None else model
    if against is None:
        return
    with np.errstate(all="ignore"):  # what is infinite is beyond every bound
        name, wider = ("the captured reference", CAPTURED_FACTOR) if model is None else ("predicted_flat", 1.0)
        _check_rows(found, against, name, wider)
        if model is not None and device is not None:
            _check_shape(model, device)


def scan_of(surface: Surface, skin: Skin) -> ReferenceScan:
    """Return the scan of a reference that is about to be captured.

    Args:
        surface: The sheet's present surface, with its prediction.
        skin: The skin of the surface.

    Raises:
        BadReference: It has no prediction, or that cannot be of this cloud.
    """
    if surface.predicted_V is None or surface.predicted_flat_V is None:
        raise BadReference(
            "the scan has no prediction; make it with 'eitskin surface POINTS --predict --out CLOUD.npz'"
        )
    try:
        cloud, _ = check_sheet(surface.cloud_mm, skin)
        check_prediction(surface.predicted_V, surface.predicted_flat_V, None)
    except ValueError as error:
        raise BadReference(f"the reference's scan: {error}") from error
    return ReferenceScan(np.round(cloud, DECIMALS), surface.predicted_V, surface.predicted_flat_V)


def _check_rows(found: Array, against: Array, name: str, wider: float) -> None:
    usable = _usable(against, name)
    ratio = found[usable] / against[usable]
    if wider > 1.0 and np.median(ratio) < 0.0:
        ratio = -ratio  # a front end whose polarity is the other one
    rows = np.flatnonzero(usable)
    for worst, wrong in (
        (int(ratio.argmin()), ratio.min() < RATIO[0] / wider),
        (int(ratio.argmax()), ratio.max() > RATIO[1] * wider),
    ):
        if wrong:
            raise ValueError(
                f"predicted[{rows[worst]}] is {ratio[worst]:.3g} times {name}, expected {RATIO[0] / wider:.2g} to "
                f"{RATIO[1] * wider:.2g} times: {PREDICTION_HINT}"
            )


def _usable(against: Array, name: str) -> npt.NDArray[np.bool_]:
    try:
        return np.asarray(~weak_rows(against))
    except ValueError as error:
        raise ValueError(f"{name} holds no voltage: {PREDICTION_HINT}") from error


def _check_shape(model: Array, device: Array) -> None:
    usable = _usable(device, "the captured reference")
    ratio = np.log(np.abs(model[usable] / device[usable]) + 1e-300)
    apart = float(np.median(np.abs(ratio - np.median(ratio))))
    if apart > LARGEST_SHAPE:
        raise ValueError(
            f"predicted_flat differs from the captured reference by {np.expm1(apart):.0%} in the median row beyond a "
            f"common factor, expected at most {np.expm1(LARGEST_SHAPE):.0%}: is it of this table of rows, is the "
            "captured sheet flat, are electrodes in order ('eitskin doctor')?"
        )
