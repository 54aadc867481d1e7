"""One frame, ready to be explained: what it reads, how far off a model may be, and how far off one is.

Model and reading are compared as V over the flat, untouched V, so that gain and units drop out. The covariance is that
of the frame's own reading, the same for every set of touches that is tried on it, so that their chi-squared compare.
"""

from typing import Final

import numpy as np

from eitskin_sim.verification.residual import Array, Noise, Rows, Whitener
from eitskin_sim.verification.sheet.model import Model

OWN: Final = 0.01
"""What a model is off of what touches change, as a share: elements, and what the sheet's errors do to touches."""


class Frame:
    """One frame.

    Args:
        change: (rows,) dV as read.
        reference: (rows,) V of the flat, untouched sheet.
        noise: Of the reading.
        sheet: What is known of the sheet; None is a model that is right.
        rows: (rows,) which rows there are; None is all.
        signal: (rows,) dV that touches make, by the best that is known.
    """

    def __init__(
        self,
        change: Array,
        reference: Array,
        noise: Noise,
        sheet: Model | None = None,
        rows: Rows | None = None,
        signal: Array | None = None,
    ) -> None:
        read = np.asarray(change, dtype=np.float64)
        self.ratio: Array = 1.0 + read
        """(rows,) V over the flat, untouched V, less what is known that the model does not say."""
        if sheet is None:
            none = np.zeros((len(read), 0))
            self.white = Whitener(noise.sd(read, reference), none, self.ratio, rows, 0.0)
        else:
            own = None if signal is None else OWN * np.abs(signal)
            self.white = sheet.whitener(read, reference, noise, rows=rows, own=own)
            self.ratio = self.ratio - sheet.expected(sheet.ratio(read))

    def chi_squared(self, ratio: Array) -> Array:
        """Return (...,) the chi-squared of modelled V over flat V (..., rows)."""
        return self.white.chi_squared(self.ratio - ratio)

    def whiten(self, ratio: Array) -> Array:
        """Return (..., kept rows) whitened differences of modelled V over flat V (..., rows)."""
        return self.white.whiten(ratio)


def check_frame(voltages_V: Array, reference_V: Array, shares: Array | None = None) -> None:
    """Raise ValueError if a frame is no frame.

    Args:
        voltages_V: (rows,) as read.
        reference_V: (rows,) flat and untouched.
        shares: Of a map, of any shape; None without one.
    """
    if voltages_V.shape != reference_V.shape:
        raise ValueError(f"voltages {voltages_V.shape}: expected {reference_V.shape}, as the reference has")
    parts = {"voltages": voltages_V, "shares of the map": shares, "the reference": reference_V}
    for name, values in parts.items():
        wrong = 0 if values is None else int((~np.isfinite(values)).sum())
        if values is not None and wrong:
            raise ValueError(f"{name}: {wrong} of {values.size} are not finite; leave out such a frame")
    if not np.all(reference_V):
        raise ValueError(f"the reference: {int((reference_V == 0.0).sum())} rows of 0 V; take one with all rows")
