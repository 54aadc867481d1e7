"""Checks whether a prediction can belong to its cloud and to the device: V_pred against the flat sheet's voltages.

A prediction in other units, of another table of rows, or of nothing, has 104 finite numbers like any other. The range
that deformations cause was measured on 810 of them (the paper's ten, 400 draws each of the families A and B; see
:mod:`eitskin_proto.skin.sheet_cloud`)::

    V_pred / V_flat                                              drawn            refused outside
    in any row                                                   0.22 to 2.8      0.08 to 6
    median of log, less what the cloud's size explains           -0.09 to 0.09    -0.25 to 0.25

The second is 0.08 log(stretch along x) + 1.88 log(stretch along y): sixteen electrodes are nearer to each other across
the sheet than along it. It detects a prediction of another scale; one of another cloud mostly passes.

That is the paper's skin, 1.5 times as long as wide; of other proportions the two numbers are interpolated, since a
sheet that is 1.5 times as wide as long has them exchanged. A gauge factor adds itself to both.

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
from eitskin_proto.skin.skin import PAPER, Skin

Array = npt.NDArray[np.float64]

LARGEST_EXCESS: Final = 0.25
"""Of the median log ratio over what the cloud's size explains."""

STRETCH_WEIGHTS: Final = (0.08, 1.88)
"""What the logarithms of the mean stretch along x and y count in the median log ratio; a fit to the same draws."""

CAPTURED_FACTOR: Final = 3.0
"""How much wider bounds are against a captured reference."""

LARGEST_SHAPE: Final = 0.5
"""Median |log| between the model's flat sheet and the captured one, a common factor taken out."""

PREDICTION_HINT: Final = (
    "give the forward model's V_pred of this cloud and predicted_flat, its own V of the flat sheet, both in V"
)


def check_prediction(
    cloud: npt.ArrayLike,
    predicted: npt.ArrayLike,
    predicted_flat: npt.ArrayLike | None,
    captured: Reference | None,
    skin: Skin = PAPER,
) -> None:
    """Refuse a prediction that cannot be of this cloud or this device.

    Args:
        cloud: (3, rows, columns) mm, of this sheet.
        predicted: (104,) V, of this cloud, by the forward model.
        predicted_flat: (104,) V, of the flat sheet, by the same model; None takes the captured reference.
        captured: The device's reference; None if there is none.
        skin: The skin of the surface.

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
        _check(_explained(cloud, skin), found, against, model, device)


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
        check_prediction(cloud, surface.predicted_V, surface.predicted_flat_V, None, skin)
    except ValueError as error:
        raise BadReference(f"the reference's scan: {error}") from error
    return ReferenceScan(np.round(cloud, DECIMALS), surface.predicted_V, surface.predicted_flat_V)


def _check(explained: float, found: Array, against: Array, model: Array | None, device: Array | None) -> None:
    name, wider = ("the captured reference", CAPTURED_FACTOR) if model is None else ("predicted_flat", 1.0)
    _check_level(found, against, name, wider, explained)
    if model is not None and device is not None:
        _check_shape(model, device)


def _explained(cloud: npt.ArrayLike, skin: Skin) -> float:
    """Return what the cloud's size is worth in the median log ratio."""
    points = np.asarray(cloud, dtype=np.float64)
    dx, dy = skin.grid.pixel_mm
    stretch = [
        np.linalg.norm(np.diff(points, axis=axis), axis=0).mean() / pitch_mm for axis, pitch_mm in ((2, dx), (1, dy))
    ]
    return float(np.dot(_exponents(skin), np.log(stretch)))


def _exponents(skin: Skin) -> Array:
    """Return what the logarithms of the mean stretch along x and y count."""
    (length, width), (long, wide) = skin.outline.size_mm, PAPER.outline.size_mm
    share = (1.0 + float(np.clip(np.log(length / width) / np.log(long / wide), -1.0, 1.0))) / 2.0
    along, across = np.array(STRETCH_WEIGHTS), np.array(STRETCH_WEIGHTS[::-1])
    return np.asarray(share * along + (1.0 - share) * across + float(skin.layer.gauge_factor.nominal(1)[0]))


def _check_level(found: Array, against: Array, name: str, wider: float, explained: float) -> None:
    usable = _usable(against, name)
    ratio = found[usable] / against[usable]
    middle = float(np.median(ratio))
    if wider > 1.0 and middle < 0.0:
        ratio, middle = -ratio, -middle  # a front end whose polarity is the other one
    excess = np.log(middle) - explained if middle > 0.0 else -np.inf
    if abs(excess) > LARGEST_EXCESS * wider:
        low, high = np.exp(explained + np.array([-1.0, 1.0]) * LARGEST_EXCESS * wider)
        raise ValueError(
            f"predicted is {middle:.3g} times {name} (median row), expected {low:.3g} to {high:.3g} times for this "
            f"cloud: {PREDICTION_HINT}"
        )
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
