"""The effect of a front end on a tank's voltages: one offset for all rows, and one complex gain for each pair.

    z[s, m] = offset + gain[m] v[s, m]

with v the model's voltages of water. The rows span a factor of 50, and an offset of an eighth of the largest is more
than the smallest: it must go before anything is divided. The gains cancel in a ratio; they say how well the model
explains the tank. Least squares are of relative errors, so that small rows count as well as large ones; since the
weights are the fit's own, they are found in a few rounds.

A good front end needs no correction, and the fit then follows the model's errors. Where raw rows and their reciprocals
agree better than corrected ones, the correction is left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import FULL_TABLE, N_ELECTRODES, N_FULL_ROWS, RECIPROCAL_IN_FULL, ROW_IN_FULL
from eitskin_sim.arrays import Array

Complex = npt.NDArray[np.complex128]

LOWEST_LEVEL: Final = 0.01
"""Of a frame of water, over the range of its levels."""

WEIGHT_ROUNDS: Final = 8
"""Of weights; they settle to 1e-4 in five."""


@dataclass(frozen=True, slots=True, eq=False)
class OffsetAndGains:
    """The front end fitted to one frame of water."""

    offset_V: complex
    gains: Complex
    """(16,) of the measured pairs; V of the instrument per V of the model."""
    residual: float
    """Rms of the rows' relative errors."""
    reciprocity: float
    """Rms relative difference between rows (s, m) and (m, s), the offset and the gains taken out: what no passive tank
    explains."""
    raw: bool = False
    """Whether rows are used as read, without an offset, because they are more reciprocal so."""

    def change(self, water_V: Complex, objects_V: Complex) -> Array:
        """Return the (104,) relative change of every row, in phase, the mean of it and its reciprocal."""
        full = ((objects_V - water_V) / (water_V - self.offset_V)).real
        return np.asarray((full[ROW_IN_FULL] + full[RECIPROCAL_IN_FULL]) / 2)


def fit_front_end(water_V: Complex, model_V: Array) -> OffsetAndGains:
    """Return the front end that explains a frame of water.

    Args:
        water_V: (208,) as measured.
        model_V: (208,) of the model, any current.

    Raises:
        ValueError: Rows do not tell the offset from the gains.
    """
    rows, measure = np.arange(N_FULL_ROWS), FULL_TABLE[:, 1].astype(np.intp)
    design = np.zeros((N_FULL_ROWS, 1 + N_ELECTRODES))
    design[:, 0] = 1.0
    design[rows, 1 + measure] = model_V
    weight = 1.0 / np.abs(model_V)
    for _ in range(WEIGHT_ROUNDS):
        found, _, rank, _ = np.linalg.lstsq(design * weight[:, None], water_V * weight, rcond=None)
        explained = design[:, 1:] @ found[1:]
        if rank < design.shape[1] or not np.abs(explained).min() > 0.0:
            raise ValueError("the water frame does not tell the offset from the gains; is a measured pair dead?")
        weight = 1.0 / np.abs(explained)
    ratio = (water_V - found[0]) / explained
    apart = ratio[ROW_IN_FULL] - ratio[RECIPROCAL_IN_FULL]
    reciprocity = float(np.sqrt(np.mean(np.abs(apart) ** 2)))
    one, other = water_V[ROW_IN_FULL], water_V[RECIPROCAL_IN_FULL]
    uncorrected = float(np.sqrt(np.mean(np.abs(2.0 * (one - other) / (one + other)) ** 2)))
    return OffsetAndGains(
        offset_V=0j if uncorrected < reciprocity else complex(found[0]),
        gains=np.asarray(found[1:], dtype=np.complex128),
        residual=float(np.sqrt(np.mean(np.abs(ratio - 1.0) ** 2))),
        reciprocity=min(uncorrected, reciprocity),
        raw=uncorrected < reciprocity,
    )


def levels_of(water_V: Complex) -> Array:
    """Return (208,) levels above 0 of a frame of water, in the order of their sizes whatever the offset.

    Without an offset and noise, complex readings are on a line through 0. Levels are the places along that line, of
    which few are far from the others.
    """
    apart = water_V - np.median(water_V.real) - 1j * np.median(water_V.imag)
    along = (apart * np.exp(-0.5j * np.angle(np.sum(apart**2)))).real
    along = along * np.sign(np.sum(along**3))
    return np.asarray((along - along.min()) / np.ptp(along) + LOWEST_LEVEL)


def best_model(waters_V: Sequence[Complex], models_V: Sequence[Array]) -> int:
    """Return which of several models of one tank explains all its frames of water best."""
    return int(np.argmin([np.mean([fit_front_end(water, model).residual for water in waters_V]) for model in models_V]))
