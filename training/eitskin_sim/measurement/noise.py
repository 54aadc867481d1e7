"""Measurement noise in three definitions, because "SNR 50 dB" does not say of what.

::

    N1   s = sqrt(mean(dV^2)) * 10^(-SNR/20)     added to dV; mean over the sample's rows     paper-like, mildest
    N2   V (1 + e * 10^(-SNR/20))                every row by its own size                    a multiplicative error
    N3   V + e * sqrt(mean(V^2)) * 10^(-SNR/20)  one level for all rows                       hardware-like, hardest

with e standard normal and independent in every row. All three take and return volts, so a solver cannot tell them apart
by their form; N1 is carried over by V = V0 (1 + dV). Under N3 the weakest rows, 500 times smaller than the strongest,
drown.
"""

from typing import Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.normalise import relative_change

Kind = Literal["N1", "N2", "N3", "none"]
"""Which definition."""

KINDS: Final[tuple[str, ...]] = get_args(Kind)
"""The names of the definitions, and "none"."""

NOISES: Final[tuple[Kind, ...]] = ("N1", "N2", "N3")
"""The definitions."""


def add_noise(
    voltages: npt.NDArray[np.floating],
    reference: npt.NDArray[np.floating],
    kind: Kind,
    snr_db: float | npt.NDArray[np.float64],
    rng: np.random.Generator,
) -> npt.NDArray[np.float64]:
    """Return voltages as a noisy instrument would measure them.

    Args:
        voltages: (..., rows) V, free of noise.
        reference: (rows,) V, the one that dV is taken against; only N1 uses it.
        kind: "N1", "N2", "N3" or "none".
        snr_db: Signal to noise ratio in dB of amplitude squared; one, or (..., 1).
        rng: Source of the noise.

    Returns:
        (..., rows) V. The input is left as it was.

    Raises:
        ValueError: The kind is unknown.
    """
    if kind not in KINDS:
        raise ValueError(f"noise {kind!r} is unknown; expected one of {', '.join(KINDS)}")
    clean = np.asarray(voltages, dtype=np.float64)
    if kind == "none":
        return clean.copy()
    level = 10.0 ** (-snr_db / 20.0)
    draw = rng.standard_normal(clean.shape)
    if kind == "N2":
        return np.asarray(clean * (1.0 + level * draw))
    if kind == "N3":
        return np.asarray(clean + level * _rms(clean) * draw)
    return np.asarray(clean + level * _rms(relative_change(clean, reference)) * draw * reference)


def spread_of(reference: npt.NDArray[np.float64], kind: Kind, snr_db: float) -> npt.NDArray[np.float64]:
    """Return (rows,) V by which noisy frames of the flat, untouched sheet vary; N1 is noise of a touch, and adds none.

    Args:
        reference: (rows,) V of that sheet.
        kind: Definition of the noise.
        snr_db: Its level.
    """
    level = 10.0 ** (-snr_db / 20.0)
    if kind == "N3":
        return np.asarray(np.full_like(reference, level * _rms(reference)))
    return np.asarray(level * np.abs(reference) if kind == "N2" else np.zeros_like(reference))


def _rms(rows: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.asarray(np.sqrt(np.mean(np.square(rows), axis=-1, keepdims=True)))
