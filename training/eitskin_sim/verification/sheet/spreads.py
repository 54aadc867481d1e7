"""How far a sheet may differ from its model, before anything is measured."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import Skin

Array = npt.NDArray[np.float64]

SCAN_NOISE_MM: Final = 0.1
"""Of a scanner, where the skin does not say."""


@dataclass(frozen=True, slots=True)
class Spreads:
    """Standard deviations of what may differ; 0 leaves one out."""

    drift: float = 0.05
    """Of the whole layer's conductivity since the reference, as a part of it."""
    tilt: float = 0.01
    """Of its planes along x and along y, each of rms 1."""
    gauge: float = 0.5
    """Of k, where conductivity goes by (area stretch)^-k."""
    material: float = 1.0
    """Of material that lies elsewhere than a scan can tell: over what the skin's deformations say."""
    scan_mm: float = SCAN_NOISE_MM
    """Noise of the scanner."""


def usual(skin: Skin) -> Spreads:
    """Return what a verifier assumes that is told nothing of the device but its skin.

    Of the scanner that is the least noise that the skin states: a scan that has more shows it by its own points
    (:mod:`eitskin_sim.verification.sheet.scan_noise`).
    """
    return Spreads(scan_mm=skin.may_be_off.scan_noise_mm[0] or SCAN_NOISE_MM)


def layer_fields(xy_mm: Array, metric: Array, skin: Skin, spreads: Spreads) -> dict[str, tuple[Array, float]]:
    """Return by name (n,) changes of the layer's log conductivity, and the standard deviation of how much of each.

    Args:
        xy_mm: (n, 2) flat places.
        metric: (n, 3) E, F, G there.
        skin: Whose layer.
        spreads: How much may differ.
    """
    length, width = skin.outline.size_mm
    x, y = xy_mm.T
    E, F, G = metric.T
    return {
        "drift": (np.ones(len(xy_mm)), spreads.drift),
        "tilt x": (np.sqrt(12.0) * (x / length - 0.5), spreads.tilt),
        "tilt y": (np.sqrt(12.0) * (y / width - 0.5), spreads.tilt),
        "gauge": (-0.5 * np.log(E * G - F**2), spreads.gauge),
    }
