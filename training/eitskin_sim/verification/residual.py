"""Residuals of dV, whitened by the noise and the model's error.

A residual is linear, r = dV measured - dV modelled: logarithms exaggerate noise in weak rows, and raised
false alarms from none to 13 % under N3. Its covariance is a diagonal and a few columns ::

    C = diag(sd^2) + M M^T        sd   noise, and a small floor
                                  M    (rows, m) one column for each way in which model and sheet may differ, of one
                                       standard deviation: model errors, and nuisances that are fitted along

With the amplitudes of M normally distributed, r C^-1 r is the remainder after fitting them plus their own cost; it has
as many degrees of freedom as there are rows. With missing rows, one block of C is used.
"""

from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from eitskin_sim.arrays import Array
from eitskin_sim.verification import constants as c

Rows = npt.NDArray[np.bool_]

Law = Literal["N1", "N2", "N3", "none", "measured"]
"""How noise goes with the signal, as in :mod:`eitskin_sim.measurement.noise`; "measured" states each row's own."""

LAWS: Final[tuple[str, ...]] = get_args(Law)
"""The laws."""


@dataclass(frozen=True, slots=True)
class Noise:
    """The noise of one frame.

    Args:
        law: How it goes with the signal.
        snr_db: Its level, but for "measured".
        measured: (rows,) standard deviation of dV, only for "measured"; that of each row alone where some is shared.
        shared: (rows, k) components of dV's noise that rows share (:mod:`eitskin_proto.sensor.noise_law`).
    """

    law: Law = "N2"
    snr_db: float = 50.0
    measured: Array | None = None
    shared: Array | None = None

    def __post_init__(self) -> None:
        """Check the law."""
        if self.law not in LAWS:
            raise ValueError(f"noise {self.law!r} is unknown; expected one of {', '.join(LAWS)}")
        if (self.law == "measured") != (self.measured is not None):
            raise ValueError(f"noise {self.law!r}: 'measured' needs the rows' standard deviations, others take none")

    def of_mean(self, frames: int) -> "Noise":
        """Return the noise of the mean of some frames.

        Raises:
            ValueError: There are none.
        """
        if frames < 1:
            raise ValueError(f"{frames} frames: a mean is of 1 at least")
        if self.measured is not None:
            shared = None if self.shared is None else self.shared / np.sqrt(frames)
            return Noise("measured", measured=self.measured / np.sqrt(frames), shared=shared)
        return Noise(self.law, self.snr_db + 10.0 * float(np.log10(frames)))

    def sd(self, change: Array, reference: Array) -> Array:
        """Return (rows,) the standard deviation of dV.

        Args:
            change: (rows,) dV of the frame: what it reads, or what is modelled; NaN in rows that are missing.
            reference: (rows,) V.
        """
        if self.measured is not None:
            return np.asarray(self.measured, dtype=np.float64)
        level = 10.0 ** (-self.snr_db / 20.0)
        if self.law == "N1":
            return np.full(len(change), level * float(np.sqrt(np.nanmean(np.square(change)))))
        if self.law == "N2":
            return np.asarray(level * np.abs(1.0 + change))
        if self.law == "N3":
            volts = reference * (1.0 + change)
            return np.asarray(level * float(np.sqrt(np.nanmean(np.square(volts)))) / np.abs(reference))
        return np.zeros(len(change))

    def covariance(self, change: Array, reference: Array) -> Array:
        """Return (rows, rows) the covariance of dV, never singular; arguments as of :meth:`sd`."""
        shared = np.zeros((len(change), 0)) if self.shared is None else self.shared
        return np.asarray(np.diag(np.square(self.sd(change, reference)) + c.MIN_SD_OF_DV**2) + shared @ shared.T)


class Whitener:
    """Turns residuals of one frame into numbers that scatter by 1, independently, if the model is right.

    Args:
        sd: (rows,) standard deviation of dV by noise.
        columns: (rows, m) dV of every model error and nuisance, for one standard deviation of it.
        size: (rows,) V over V0 of the frame, which the floor goes with; None is 1.
        rows: (rows,) which rows there are; None is all of them.
        floor: Added to the noise in quadrature, of ``size``.

    Raises:
        ValueError: Fewer than two rows are left, or shapes differ.
    """

    def __init__(
        self,
        sd: Array,
        columns: Array,
        size: Array | None = None,
        rows: Rows | None = None,
        floor: float = c.MESH_ERROR,
    ) -> None:
        self.rows: Rows = np.ones(len(sd), dtype=np.bool_) if rows is None else np.asarray(rows, dtype=np.bool_)
        if columns.ndim != 2 or len(columns) != len(sd) or self.rows.shape != sd.shape:
            raise ValueError(f"columns {columns.shape} and rows {self.rows.shape} do not fit {len(sd)} rows")
        if self.rows.sum() < 2:
            raise ValueError(f"{int(self.rows.sum())} rows are left; a verdict needs at least 2")
        around = floor * (np.ones(len(sd)) if size is None else np.abs(size))
        variance = (np.square(sd) + np.square(around) + c.MIN_SD_OF_DV**2)[self.rows]
        self.columns: Array = np.ascontiguousarray(columns[self.rows])
        """(kept rows, m)"""
        covariance = self.columns @ self.columns.T
        covariance[np.diag_indices(len(covariance))] += variance
        root, failed = lapack.dpotrf(covariance, lower=1)
        if failed:
            raise ValueError(f"the covariance of row {failed} is not positive; expected finite noise and columns")
        inverse, _ = lapack.dtrtri(root, lower=1)
        self.matrix: Array = np.ascontiguousarray(np.tril(inverse))
        """(kept rows, kept rows) W with W C W^T = 1."""

    def __len__(self) -> int:
        """Return how many rows there are: the degrees of freedom before anything else is fitted."""
        return len(self.matrix)

    def whiten(self, residual: Array) -> Array:
        """Return the (..., kept rows) whitened residuals of (..., rows)."""
        return np.asarray(residual[..., self.rows] @ self.matrix.T)

    def chi_squared(self, residual: Array) -> Array:
        """Return the (...,) sums of squares of whitened residuals of (..., rows)."""
        white = self.whiten(residual)
        return np.asarray(np.einsum("...r,...r->...", white, white))

    def amplitudes(self, residual: Array) -> Array:
        """Return (m,) how much of every column is in a residual (rows,), in standard deviations."""
        white = self.matrix @ self.columns
        return np.asarray(white.T @ (self.matrix @ residual[self.rows]))


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
