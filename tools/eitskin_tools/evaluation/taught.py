"""Evaluates a taught bundle on recorded presses: the error of the place of every press, and the gate.

Readings are judged in the order of the file, each by itself, by the code of a running stream. Three ways to hold them
against the untouched sheet are compared: the last untouched reading, as the baseline of a stream does (the figures at
the top); the first one; and the first one with the rows' common factor taken out.
"""

from typing import Any, Final

import numpy as np

from eitskin.model.bundle import Bundle
from eitskin.model.taught import field_of
from eitskin_proto.errors import MismatchError
from eitskin_proto.files.arrays import Array
from eitskin_tools.teach.presses import Presses, PressesError, Way
from eitskin_tools.teach.teaching import Placed, place

WAYS: Final[dict[Way, str]] = {
    "last": "the last untouched reading",
    "first": "the first untouched reading",
    "common": "the first, without the common factor",
}


def evaluate_taught(presses: Presses, bundle: Bundle) -> dict[str, Any]:
    """Return the figures of a taught bundle on presses.

    Args:
        presses: That it was not taught.
        bundle: With a field.

    Raises:
        MismatchError: The presses have other rows, or are on another sheet.
        PressesError: There is no press.
    """
    field = field_of(bundle)
    assert field is not None
    table, skin = bundle.table, bundle.skin
    if presses.table.rows != table.rows or (
        presses.table.electrodes is not None and table.electrodes is not None and presses.table.id != table.id
    ):
        hint = "take presses that were recorded with the rows of the bundle"
        raise MismatchError("rows", found=presses.table.name, expected=table.name, hint=hint)
    if not np.allclose(presses.size_mm, skin.outline.size_mm, atol=0.5):
        hint = "take presses of the sheet that the bundle was taught on"
        raise MismatchError("size_mm", found=str(presses.size_mm), expected=str(skin.outline.size_mm), hint=hint)
    if presses.logarithmic != field.logarithmic:
        raise PressesError("the presses have changes of another unit than those that the bundle was taught with")
    if not presses.pressed.any():
        raise PressesError("xy_mm has no place, so nothing was pressed; expected at least one press")
    ways: tuple[Way, ...] = ("last",) if presses.is_change else ("last", "first", "common")
    found = {way: _figures(place(field, presses.logarithms(way), presses.against(way)), presses) for way in ways}
    return {
        "bundle": bundle.id,
        "solver": "taught",
        **found["last"],
        "against": {WAYS[way]: found[way] for way in ways},
    }


def table(found: dict[str, Any]) -> str:
    """Return the figures as text."""
    lines = [f"{found['presses']} presses, {found['untouched']} untouched readings; errors of the place in mm"]
    lines.append(f"{'held against':<38}{'median':>8}{'p90':>8}{'surer half':>12}{'missed':>9}{'false':>8}{'1 sd':>7}")
    for way, one in found["against"].items():
        false = "" if one["false_touches"] is None else f"{one['false_touches']:.1%}"
        lines.append(
            f"{way:<38}{one['localisation_median_mm']:>8.2f}{one['localisation_p90_mm']:>8.2f}"
            f"{one['surer_half_median_mm']:>12.2f}{one['missed']:>9.1%}{false:>8}{one['stated_within_1sd']:>7.0%}"
        )
    return "\n".join(lines)


def _figures(placed: Placed, presses: Presses) -> dict[str, Any]:
    pressed = presses.pressed
    untouched = ~pressed
    untouched[np.flatnonzero(untouched)[:1]] = False  # there is none before the first
    apart = placed.place_mm[pressed] - presses.xy_mm[pressed]
    error, sd = np.hypot(*apart.T), placed.sd_mm[pressed]
    size = np.hypot(*sd.T)
    return {
        "presses": len(error),
        "untouched": int(untouched.sum()),
        "localisation_median_mm": float(np.median(error)),
        "localisation_p90_mm": float(np.quantile(error, 0.9)),
        "localisation_rms_mm": float(np.sqrt((error**2).mean())),
        "surer_half_median_mm": float(np.median(error[size <= np.median(size)])),
        "stated_within_1sd": float((np.abs(apart) < sd).mean()),
        "missed": float((placed.margin[pressed] <= 0.0).mean()),
        "false_touches": float((placed.margin[untouched] > 0.0).mean()) if untouched.any() else None,
        "gate_auc": _auc(placed.margin[pressed], placed.margin[untouched]) if untouched.any() else None,
    }


def _auc(touched: Array, untouched: Array) -> float:
    """Return the probability that a press looks more like a touch than an untouched reading does."""
    return float((touched[:, None] > untouched).mean() + 0.5 * (touched[:, None] == untouched).mean())
