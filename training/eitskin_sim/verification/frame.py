"""One frame as it is read: dV against the flat, untouched sheet, and whether it can be verified."""

import numpy as np

from eitskin_sim.verification.residual import Array, Rows


def change_of(voltages_V: Array, reference_V: Array, rows: Rows | None = None) -> Array:
    """Return (rows,) dV; NaN in rows that are missing.

    Args:
        voltages_V: (rows,) as read.
        reference_V: (rows,) flat and untouched.
        rows: (rows,) which rows there are; None is all.
    """
    change = voltages_V / reference_V - 1.0
    return change if rows is None else np.where(rows, change, np.nan)


def check_frame(voltages_V: Array, reference_V: Array, shares: Array | None = None, rows: Rows | None = None) -> None:
    """Raise ValueError if a frame cannot be verified.

    Args:
        voltages_V: (rows,) as read.
        reference_V: (rows,) flat and untouched.
        shares: Of a map, of any shape; None without one.
        rows: (rows,) which rows there are; None is all. What the others read does not matter.
    """
    if voltages_V.shape != reference_V.shape:
        raise ValueError(f"voltages {voltages_V.shape}: expected {reference_V.shape}, as the reference has")
    kept = slice(None) if rows is None else rows
    parts = {"voltages": voltages_V[kept], "shares of the map": shares, "the reference": reference_V[kept]}
    for name, values in parts.items():
        wrong = 0 if values is None else int((~np.isfinite(values)).sum())
        if values is not None and wrong:
            raise ValueError(f"{name}: {wrong} of {values.size} are not finite; leave out such a frame")
