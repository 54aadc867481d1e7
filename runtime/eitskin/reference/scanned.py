"""Converts a reference of a scanned, bent sheet into the one of a flat sheet.

If the sheet was stretched when its reference was captured, the stretch makes every dV wrong. With a scan of that moment
the forward model computes its effect, and the reference becomes that of a flat sheet::

    V0_flat = V0 * V_model(flat) / V_model(scan)

Both inputs of a network, dV and log(V / V_pred), are shifted by it alike. The model's own error and the device's gain
drop out of the ratio. The file keeps the captured voltages; frames are compared with the flat ones.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ROWS

Array = npt.NDArray[np.float64]

DECIMALS: Final = 4
"""Of a stored cloud, mm: far below any scanner's noise."""

RATIO: Final = (0.08, 6.0)
"""V_pred / V_flat in any row."""


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceScan:
    """A scan and the forward model's prediction for it."""

    cloud_mm: Array
    """(3, rows, columns)"""
    predicted_V: Array
    """(104,) of the scanned sheet, untouched."""
    predicted_flat_V: Array
    """(104,) of the same model's flat sheet."""

    @classmethod
    def parse(cls, value: Any) -> "ReferenceScan":
        """Return what :meth:`stored` made.

        Raises:
            KeyError: Something is missing.
            TypeError: It is not what it should be.
            ValueError: The same, or a ratio that no deformation gives.
        """
        found = cls(*(_numbers(value[name]) for name in ("cloud_mm", "predicted_V", "predicted_flat_V")))
        if found.cloud_mm.ndim != 3 or len(found.cloud_mm) != 3:
            raise ValueError(f"the scan's cloud has shape {found.cloud_mm.shape}, expected (3, rows, columns)")
        for name in ("predicted_V", "predicted_flat_V"):
            if (shape := getattr(found, name).shape) != (N_ROWS,):
                raise ValueError(f"the scan's {name} has shape {shape}, expected ({N_ROWS},)")
        found.flattening()
        return found

    def stored(self) -> dict[str, Any]:
        """Return plain values for a file."""
        return {
            "cloud_mm": self.cloud_mm.tolist(),
            "predicted_V": self.predicted_V.tolist(),
            "predicted_flat_V": self.predicted_flat_V.tolist(),
        }

    def flattening(self) -> Array:
        """Return (104,) V_model(flat) / V_model(scan); 1 where the model has no voltage.

        Raises:
            ValueError: A row that no deformation gives.
        """
        there = (self.predicted_flat_V != 0.0) & (self.predicted_V != 0.0)
        ratio = np.divide(self.predicted_V, self.predicted_flat_V, out=np.ones(N_ROWS), where=there)
        bad = np.flatnonzero((ratio < RATIO[0]) | (ratio > RATIO[1]))
        if bad.size:
            raise ValueError(
                f"the scan's prediction of row {bad[0]} is {ratio[bad[0]]:.3g} times that of the flat sheet, expected "
                f"{RATIO[0]:g} to {RATIO[1]:g} times"
            )
        return np.asarray(1.0 / ratio)


def _numbers(values: Any) -> Array:
    found = np.array(values, dtype=np.float64)
    if not np.isfinite(found).all():
        raise ValueError("the scan holds a number that is not finite")
    return found
