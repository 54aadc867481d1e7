"""The detection rate of an ideal observer, for comparison with a gate's misses.

A press of known place and strength changes log V by s, noise has a variance v a row and frame, and what is not known
of the untouched sheet has a covariance N. The best linear observer of n frames together then has ::

    d'^2 = s' (N + v / n)^-1 s        1 of N: a factor common to all rows, of any size, is taken out of s and of N

It finds a share Phi(d' - z) at a false-alarm rate of 1 - Phi(z). s is of first order, by the Jacobian of the flat
sheet. What N holds does not average out: another frame helps against noise alone. Without N it is the bound of noise
and drift; with N from untouched sheets it is that of an observer that knows neither bend nor device.
"""

from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, Final

import numpy as np

from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.fem.jacobian import flat_jacobian
from eitskin_sim.scene.touch_table import TouchTable, gather
from eitskin_training.gate.presses import DIAMETER_MM, STRENGTH_MM2, press

SNR_DB: Final = 52.0
"""N2 noise of measured skins."""

FRAMES_TO_FIND_A_PRESS: Final = 5
"""In which a press is to be found."""

PLACES: Final = (9, 6)
"""Along and across the sheet, at which presses are judged."""


def press_signals(
    jacobian: Array, skin: Skin = PAPER, strength_mm2: float = STRENGTH_MM2, diameter_mm: float = DIAMETER_MM
) -> Array:
    """Return (places, 104) first-order changes of log V by discs of a strength, anywhere on the sheet.

    Args:
        jacobian: (104, pixels), see :func:`eitskin_sim.fem.jacobian.flat_jacobian`.
        skin: Whose sheet and map.
        strength_mm2: Conductance taken away over the sheet's, times area.
        diameter_mm: Of the disc, which is even.
    """
    half, size_mm = diameter_mm / 2, skin.outline.size_mm
    lines = [np.linspace(half, side - half, count) for side, count in zip(size_mm, PLACES, strict=True)]
    table: TouchTable = gather([press(float(x), float(y), diameter_mm, 0.5, 0.0) for x in lines[0] for y in lines[1]])
    shares = table.area_table(skin.grid).toarray()
    shares *= strength_mm2 * skin.grid.n_pixels / (size_mm[0] * size_mm[1]) / shares.sum(axis=1, keepdims=True)
    return np.asarray(-shares @ jacobian.T)


def without_common(rows: int = N_ROWS) -> Array:
    """Return (r, r - 1) orthonormal directions that a factor common to all rows does not move."""
    basis, _ = np.linalg.qr(np.column_stack([np.ones(rows), np.eye(rows)[:, : rows - 1]]))
    return np.asarray(basis[:, 1:])


def detectability(signals: Array, nuisance: Array | None, noise: float, *, common: bool = True) -> Array:
    """Return (n,) d' of signals.

    Args:
        signals: (n, r) changes of log V.
        nuisance: (r, r) covariance of log V of untouched sheets; None where they are known.
        noise: Relative standard deviation of a row's mean over the frames.
        common: Whether a common factor is unknown too.
    """
    covariance = noise**2 * np.eye(signals.shape[1])
    if nuisance is not None:
        covariance = covariance + nuisance
    seen = signals
    if common:
        left = without_common(signals.shape[1])
        seen, covariance = signals @ left, left.T @ covariance @ left
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), seen.T)
    return np.asarray(np.sqrt(np.square(whitened).sum(axis=0)))


@dataclass(frozen=True, slots=True)
class Bound:
    """d' over places of a press: the median and the worst tenth, and the share that is found."""

    median: float
    low: float
    found: float

    @classmethod
    def of(cls, values: Array, false_alarms: float) -> "Bound":
        """Return the bound of (n,) d' at a false-alarm rate."""
        normal = NormalDist()
        limit = normal.inv_cdf(1.0 - false_alarms)
        share = float(np.mean([normal.cdf(float(value) - limit) for value in values]))
        return cls(round(float(np.median(values)), 2), round(float(np.quantile(values, 0.1)), 2), round(share, 4))

    def facts(self) -> dict[str, float]:
        """Return it as plain values."""
        return {"median": self.median, "lowest_tenth": self.low, "found": self.found}


def ideal_observer(untouched: Array, false_alarms: float, skin: Skin) -> dict[str, Any]:
    """Return what a bundle's card states of a press of ``STRENGTH_MM2``: d' by what is unknown, then by frames.

    Args:
        untouched: (n, 104) log(V / V0) of untouched sheets.
        false_alarms: The rate at which shares found are stated.
        skin: Whose flat sheet is pressed.
    """
    signals = press_signals(flat_jacobian(skin), skin)
    noise = 10.0 ** (-SNR_DB / 20.0)
    unknown = {"drift": None, "drift, bend and device": np.cov(untouched.T)}
    kept = np.linalg.norm(signals @ without_common(), axis=1) / np.linalg.norm(signals, axis=1)
    return {
        "strength_mm2": STRENGTH_MM2,
        "diameter_mm": DIAMETER_MM,
        "noise": f"N2 of {SNR_DB:g} dB",
        "kept_without_common_factor": round(float(np.median(kept)), 4),
        "d_prime": {
            name: {
                f"{frames}": Bound.of(detectability(signals, nuisance, noise / frames**0.5), false_alarms).facts()
                for frames in (1, FRAMES_TO_FIND_A_PRESS)
            }
            for name, nuisance in unknown.items()
        },
    }


def line(facts: dict[str, Any]) -> str:
    """Return what the fit prints of it."""
    several = str(FRAMES_TO_FIND_A_PRESS)
    parts = [
        f"{name} unknown: {by['1']['median']:.1f} in a frame, {by[several]['median']:.1f} in {several}"
        for name, by in facts["d_prime"].items()
    ]
    return (
        f"ideal observer of a press of {facts['strength_mm2']:g} mm2 under {facts['noise']}, median d' with "
        f"{'; with '.join(parts)}; {100 * facts['kept_without_common_factor']:.1f} % of its signal is not common"
    )
