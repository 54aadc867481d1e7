"""How far a flat, free sheet has drifted since its reference, how sure that is, and what to do about it.

The input is the logarithm of each voltage over the reference's. The mean over the rows is the common drift. Its
standard deviation is that of the means of single drives, because errors of one drive's rows are correlated. The rest is
uneven drift. A touch or a bend is more uneven than common; then no drift is reported.
"""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BadReference
from eitskin.reference.captured import Reference
from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS, TABLE

Array = npt.NDArray[np.float64]

LITTLE_PERCENT: Final = 1.0
"""Real sheets drift by as much within a hundred presses, and the runtime corrects for it."""

MUCH_PERCENT: Final = 8.0
"""Above, accuracy falls even where drift is taken out late."""

UNEVEN_PERCENT: Final = 1.0
"""Rms of the uneven part; 3 to 4 % of a press stays for a while, which is less."""

MAX_ROW_NOISE: Final = 0.05
"""Rows with more relative noise are ignored."""

FEWEST_ROWS: Final = N_ROWS // 2


def drift_since(voltages_V: Array, reference: Reference) -> dict[str, Any]:
    """Return how far frames of a flat, free sheet are from its reference.

    Args:
        voltages_V: (n, 104) V, at least two frames.
        reference: Captured before.

    Raises:
        BadReference: Too few rows can be compared.
    """
    flat = reference.flat()
    base, spread = np.asarray(flat.voltages_V, dtype=np.float64), np.asarray(flat.spread_V, dtype=np.float64)
    mean, noise = voltages_V.mean(axis=0), voltages_V.std(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = mean / base
        loud = np.maximum(noise / np.abs(mean), spread / np.abs(base)) > MAX_ROW_NOISE
    usable = np.isfinite(ratio) & (ratio > 0.0) & ~loud
    if usable.sum() < FEWEST_ROWS:
        raise BadReference(
            f"only {int(usable.sum())} of {N_ROWS} rows can be compared with the reference, expected {FEWEST_ROWS}: "
            "check the electrodes ('eitskin doctor --electrodes'), or capture a new reference"
        )
    change = np.log(ratio[usable])
    drives = TABLE[usable, 0]
    of_drive = np.array([change[drives == k].mean() for k in range(N_ELECTRODES) if (drives == k).any()])
    common = float(change.mean())
    sd = float(of_drive.std(ddof=1) / np.sqrt(len(of_drive)))
    by_noise = np.mean((noise / mean)[usable] ** 2) / len(voltages_V)
    uneven = float(np.sqrt(max(np.mean((change - common) ** 2) - by_noise, 0.0)))
    found = {
        "frames": len(voltages_V),
        "reference_utc": reference.captured_utc,
        "percent": round(100.0 * np.expm1(common), 3),
        "sd_percent": round(100.0 * np.exp(common) * sd, 3),
        "uneven_percent": round(100.0 * uneven, 3),
    }
    return {**found, "to_do": _advice(found["percent"], found["sd_percent"], found["uneven_percent"])}


def _advice(percent: float, sd_percent: float, uneven_percent: float) -> str:
    if uneven_percent > max(UNEVEN_PERCENT, abs(percent)):
        return (
            "the sheet is touched, bent, or has drifted unevenly: lay it flat, take your hands off and run this "
            "again; if nothing changes, capture a new reference with 'eitskin reference'"
        )
    if abs(percent) <= max(LITTLE_PERCENT, 2.0 * sd_percent):
        return "nothing to do"
    if abs(percent) <= MUCH_PERCENT:
        return "the runtime corrects for it; capture a new reference when the sheet lies flat and untouched"
    return "capture a new reference with 'eitskin reference' while the sheet lies flat and untouched"


def lines(found: dict[str, Any]) -> list[str]:
    """Return the text of :func:`drift_since` for people: the verdict, then the figures."""
    to_do: str = found["to_do"]
    return [
        f"{to_do[0].upper()}{to_do[1:]}.",
        f"drift {found['percent']:+.2f} % since the reference of {found['reference_utc']}, standard deviation "
        f"{found['sd_percent']:.2f} %, uneven {found['uneven_percent']:.2f} %",
    ]
