"""One frame, ready to be explained: what it reads, how far off a model may be, and how far off one is.

Model and reading are compared as V over the flat, untouched V, so that gain and units drop out. The covariance is that
of the frame's own reading, the same for every set of touches that is tried on it, so that their chi-squared compare.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_sim.verification.nuisance import Modes
from eitskin_sim.verification.residual import FLOOR, Array, Noise, Rows, Whitener
from eitskin_sim.verification.verdict import Fitted

OWN: Final = 0.01
"""What a model is off of what touches themselves change, as a share: elements, and what nuisances do to touches."""


@dataclass(frozen=True, slots=True, eq=False)
class Doubts:
    """How a model of one shape of the sheet may be off."""

    modes: Modes
    errors: Array
    """(rows, m) log V for one standard deviation of each further error, those of the scan."""
    floor: float = FLOOR
    own: float = OWN


class Frame:
    """One frame.

    Args:
        change: (rows,) dV as read.
        reference: (rows,) V of the flat, untouched sheet.
        noise: Of the reading.
        doubts: None is a model that is right.
        rows: (rows,) which rows there are; None is all.
        signal: (rows,) dV that touches make, by the best that is known.
    """

    def __init__(
        self,
        change: Array,
        reference: Array,
        noise: Noise,
        doubts: Doubts | None = None,
        rows: Rows | None = None,
        signal: Array | None = None,
    ) -> None:
        self.ratio: Array = 1.0 + np.asarray(change, dtype=np.float64)
        """(rows,) V over the flat, untouched V."""
        self._modes = None if doubts is None else doubts.modes
        sd, columns, floor = noise.sd(self.ratio - 1.0, reference), np.zeros((len(self.ratio), 0)), 0.0
        if doubts is not None:
            logs = np.hstack([doubts.modes.columns, doubts.errors])
            columns, floor = self.ratio[:, None] * logs, doubts.floor
            if signal is not None:
                sd = np.hypot(sd, doubts.own * np.abs(signal))
        self.white = Whitener(sd, columns, self.ratio, rows, floor)

    def chi_squared(self, ratio: Array) -> Array:
        """Return (...,) the chi-squared of modelled V over flat V (..., rows)."""
        return self.white.chi_squared(self.ratio - ratio)

    def whiten(self, ratio: Array) -> Array:
        """Return (..., kept rows) whitened differences of modelled V over flat V (..., rows)."""
        return self.white.whiten(ratio)

    def nuisances(self, ratio: Array) -> tuple[Fitted, ...]:
        """Return what was fitted along with modelled V over flat V (rows,)."""
        if self._modes is None:
            return ()
        values, errors = self.white.amplitudes(self.ratio - ratio)
        return tuple(
            Fitted(name, float(value * sd), float(error * sd))
            for name, sd, value, error in zip(self._modes.names, self._modes.sd, values, errors, strict=False)
        )


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
