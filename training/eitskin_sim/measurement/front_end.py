"""The readings of a real front end: its sink, its stray admittances, its two paths to the amplifier, gains and offsets.

The sheet is its 16 x 16 response R, volts at each electrode per ampere into each, known up to a constant: a floating
sheet has no zero of its own. From the terminals, admittances s_k lead to the instrument's ground; drive k sends I into
terminal k and takes q I out of terminal k + 1. Kirchhoff's law at the terminals, with Y the sheet's admittance, is

    (Y + diag s) U = I (e_k - q e_{k+1}),        and so        sum over k of s_k U_k = I (1 - q):

what the sink leaves goes home through the strays. A pair reads

    V[k, m] = I / q' gain_m (U[m] - minus U[m+1]) + offset,        q' = q where V is divided by the sink's current

as that part of V that is in phase with the source. Y is never formed: R + c 1 1^T / 16, with R centred, is its inverse
but for the constant mode, which gives (P + (R + c 1 1^T / 16) diag s) U = (R + c 1 1^T / 16) i, P = 1 - 1 1^T / 16.
One 16 x 16 solve serves all drives of a frame. Without strays there is none: then the front end is one that holds the
terminals' mean at ground, and what the sink leaves goes home evenly from all terminals, as through small even strays.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ELECTRODES, TABLE, voltages_from_potentials
from eitskin_sim.arrays import Array

Potentials = npt.NDArray[np.float64] | npt.NDArray[np.complex128]
Each = float | tuple[float, ...]
"""One number of all sixteen, or one of each."""


@dataclass(frozen=True, slots=True)
class FrontEnd:
    """A front end; as it stands, an ideal one.

    Raises:
        ValueError: A tuple has not 16 numbers, a number is not finite, a stray gives power, or a sink that takes
            nothing divides.
    """

    gain: Each = 1.0
    """Of each measured pair."""
    offset_per_pair_V: Each = 0.0
    """Added to every reading of a measured pair."""
    stray_S: complex | tuple[complex, ...] = 0.0
    """Admittance from each terminal to ground: that of a wire's :func:`capacitance`, or the real one of a leak."""
    minus_gain: float = 1.0
    """Of the path to the amplifier's minus input over that of plus: it turns common potential into signal."""
    sink_share: Each = 1.0
    """q, the sink's current over the source's, in each drive."""
    normalised: bool = False
    """Whether the instrument reads V over the current that returns in its sink, times the nominal current."""

    def __post_init__(self) -> None:
        for name in ("gain", "offset_per_pair_V", "stray_S", "sink_share"):
            found = np.asarray(getattr(self, name))
            if found.shape not in ((), (N_ELECTRODES,)):
                raise ValueError(f"{name} has {found.size} numbers; it must be one, or {N_ELECTRODES}")
        numbers = [np.atleast_1d(getattr(self, name)) for name in self.__slots__]
        if not all(np.isfinite(one).all() for one in numbers):
            raise ValueError(f"{self} has a number that is not finite")
        stray, share = _each(self.stray_S), _each(self.sink_share)
        if stray.real.min() < 0.0 or stray.imag.min() < 0.0:
            raise ValueError("stray_S has a negative part; a leak and a capacitance must be at least 0")
        if self.normalised and share.real.min() <= 0.0:
            raise ValueError(f"sink_share falls to {share.real.min():g} and V is divided by it; it must be above 0")

    def read(self, response: Array, table: npt.NDArray[np.uint8] = TABLE, current_A: float = 1.0) -> Array:
        """Return the (..., rows) V that this front end reads, without noise.

        Args:
            response: (..., 16, 16) ohm, the potential of each terminal under a current into each, known up to a
                constant in every column and every row.
            table: (rows, 2) drive and measure of each row: ``TABLE``, or ``FULL_TABLE`` for all 208.
            current_A: The source's.
        """
        if self == IDEAL:
            return np.asarray(current_A * voltages_from_potentials(_floating(response), table))
        drive, pair = table[:, 0].astype(np.intp), table[:, 1].astype(np.intp)
        potentials = np.asarray(self.potentials(response)).real  # (..., 16 drives, 16 terminals)
        after = (pair + 1) % N_ELECTRODES
        seen = potentials[..., drive, pair] - self.minus_gain * potentials[..., drive, after]
        scale = current_A * _each(self.gain).real[pair]
        if self.normalised:
            scale = scale / _each(self.sink_share).real[drive]
        return np.asarray(scale * seen + _each(self.offset_per_pair_V).real[pair])

    def potentials(self, response: Array) -> Potentials:
        """Return the (..., 16 drives, 16 terminals) V over ground under 1 A; complex where a stray is capacitive."""
        centre = np.eye(N_ELECTRODES) - 1.0 / N_ELECTRODES
        centred = centre @ np.asarray(response, dtype=np.float64) @ centre
        stray: Potentials = _each(self.stray_S)
        currents = np.eye(N_ELECTRODES) - _each(self.sink_share).real * np.roll(np.eye(N_ELECTRODES), 1, axis=0)
        if not stray.any():
            return np.asarray(np.swapaxes(centred @ currents, -1, -2))
        if not stray.imag.any():
            stray = stray.real
        c = 1.0 / np.abs(stray).mean()  # so that the constant mode's share of the matrix is of the size of 1
        matrix = centre + centred * stray + c * stray / N_ELECTRODES
        left_over = c * (1.0 - _each(self.sink_share).real) / N_ELECTRODES
        return np.asarray(np.swapaxes(np.linalg.solve(matrix, centred @ currents + left_over), -1, -2))


def capacitance(stray_pF: Each, frequency_Hz: float) -> complex | tuple[complex, ...]:
    """Return ``stray_S`` of capacitances to ground, pF, at the drive current's frequency."""
    found = 2j * np.pi * frequency_Hz * 1e-12 * np.asarray(stray_pF, dtype=np.float64)
    return tuple(found.tolist()) if found.ndim else complex(found)


def _each(value: complex | tuple[complex, ...]) -> npt.NDArray[np.complex128]:
    return np.array(np.broadcast_to(np.asarray(value, dtype=np.complex128), (N_ELECTRODES,)))


def _floating(response: Array) -> Array:
    """Return the (..., 16 drives, 16 terminals) V of a sheet that no ground sees, up to a constant."""
    return np.asarray(np.swapaxes(response - np.roll(response, -1, axis=-1), -1, -2))


IDEAL = FrontEnd()
"""Four wires: what the forward model gives."""


def to_voltages(response: Array) -> Array:
    """Return (..., 104) V of an ideal front end, from (..., 16, 16) potentials for a current into each electrode."""
    return IDEAL.read(response)
