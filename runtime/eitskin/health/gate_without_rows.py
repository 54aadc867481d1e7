"""Runs the gate on frames that lack rows or are noisier than its training data.

The gate asks whether a frame is an *untouched* sheet's. So a missing row gets the value of an untouched sheet, given
the other rows, which speaks neither for nor against a touch. (With missing rows filled in from touched sheets, as for
the network, the gate called every third untouched frame touched; at a threshold that cured this it missed most
touches.) ::

    l_m = E[l_m | the others, untouched]            l = log(V / V0), Gaussian over deformations of the bundle

A gate of matched filters does that by itself, with the Gaussian that it is made of, and makes up for what its filters
lose (:mod:`eitskin.model.gate`): rows filled in from outside left it blind where two electrodes were gone.

Its threshold then follows: of ``BLOCKS`` * ``BLOCK`` sheets drawn from that Gaussian, with this device's own noise by
the spread of its reference, a share of ``FALSE_ALARMS`` lies above it. Where no row is missing the bundle's threshold,
which was set on solved deformations, is the least. The sheets are drawn a block at a time while the line rests; until
all are judged the bundle's threshold holds.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.health.imputation import Consistency, Imputation, Rows
from eitskin.model.gate import Gate
from eitskin.model.small_products import product
from eitskin_proto.sensor.noise_law import own_sd
from eitskin_proto.sensor.row_gaussian import precision_of
from eitskin_proto.sensor.table import N_ROWS

Array = npt.NDArray[np.float64]

FALSE_ALARMS: Final = 0.01
"""Share of untouched frames that may be called touched: three times that of a bundle's own threshold, as for the gate
of an idle device. It costs one inference in a hundred frames, and a touch near a gap is missed less often."""

LEARNED_NOISE: Final = 0.005
"""Relative spread of a row up to which the bundle's own threshold is believed while no row is missing."""

BLOCK: Final = 50
BLOCKS: Final = 40
"""A block takes 0.8 ms: less than a frame's time even at 1000 frames/s."""

SEED: Final = 0x6A7E
"""The same sheets every time: a threshold is no matter of luck."""


class GateWithoutRows:
    """Fills rows in for a gate and sets its threshold.

    Args:
        consistency: Of the bundle.
        gate: Of the bundle; its threshold is changed.
        sigma: (104,) relative standard deviation of a single frame's rows.
        shared: (104, k) the part of it that rows share, of :mod:`eitskin_proto.sensor.noise_law`; None for none.
    """

    def __init__(self, consistency: Consistency, gate: Gate, sigma: Array, shared: Array | None = None) -> None:
        self._gate, self._sigma, self._shared = gate, sigma, None
        if shared is not None and shared.size:
            self._sigma, self._shared = own_sd(sigma, shared), shared
        covariance = consistency.untouched_covariance
        self._mean, self._half = consistency.untouched_mean, np.linalg.cholesky(covariance)
        self._precision: Array = precision_of(covariance + np.diag(sigma**2))
        self._filling = Imputation(self._mean, self._precision, consistency.ratio_range)
        self._logits: list[npt.NDArray[np.float32]] = []
        self._rng = np.random.default_rng(SEED)
        self.due = False
        """Sheets are still to be judged."""
        self.leave_out(np.zeros(N_ROWS, dtype=np.bool_))

    def leave_out(self, rows: Rows) -> None:
        """Do without these rows from the next frame on, with the bundle's threshold until there is a better one.

        Args:
            rows: (104,) missing ones.
        """
        self._missing = rows.copy()
        by_itself = self._gate.leave_out(rows)
        self._filling.leave_out(np.zeros_like(rows) if by_itself else rows, self._precision)
        self._gate.threshold = self._gate.usual_threshold
        if not by_itself:
            self._gate.reset()
        self._logits = []
        self._rng = np.random.default_rng(SEED)
        self.due = bool(rows.any() or (self._sigma > LEARNED_NOISE).any() or self._shared is not None)

    def fill(self, change: npt.NDArray[np.float32]) -> None:
        """Overwrite the missing rows of (104,) dV by an untouched sheet's."""
        self._filling.fill(change)

    def filled(self, changes: Array) -> Array:
        """Return (n, 104) dV as the gate would see them: for a look at many frames at once."""
        return self._filling.filled(changes)

    def step(self) -> None:
        """Judge a block of drawn sheets; the last one sets the threshold."""
        if not self.due:
            return
        logs = self._mean + product(self._rng.standard_normal((BLOCK, N_ROWS)), self._half.T)
        changes = np.expm1(logs) + self._sigma * self._rng.standard_normal(logs.shape)
        if self._shared is not None:
            changes += self._rng.standard_normal((BLOCK, self._shared.shape[1])) @ self._shared.T
        self._logits.append(self._gate.logits(self.filled(changes)))
        if len(self._logits) == BLOCKS:
            found = float(np.quantile(np.concatenate(self._logits), 1.0 - FALSE_ALARMS))
            whole = not self._missing.any()
            self._gate.threshold = max(found, self._gate.usual_threshold) if whole else found
            self.due = False

    def finish(self) -> None:
        """Judge all of them now."""
        while self.due:
            self.step()
