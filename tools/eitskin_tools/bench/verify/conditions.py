"""What a verifier is put through: touches, noise, and how the true device differs from the one it knows."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from eitskin_sim.evaluation.devices.mismatch import IDEAL, LAB, Mismatch
from eitskin_sim.measurement.noise import Kind

ANY: Final = (0.1, 200.0)
"""Contrasts of mixed sets: half of them below 1."""


@dataclass(frozen=True, slots=True)
class Condition:
    """One row of the table."""

    name: str
    mismatch: Mismatch = IDEAL
    noise: Kind = "N2"
    counts: tuple[int, int] = (1, 6)
    """Least and most units."""
    contrast: float | None = 50.0
    """Of all units; None is mixed."""
    missing: bool = False
    """One electrode is gone, another one for each map."""

    def contrasts(self, count: int, rng: np.random.Generator) -> list[float]:
        """Return the contrast of each of so many units."""
        if self.contrast is not None:
            return [self.contrast] * count
        raised = np.exp(rng.uniform(np.log(2.0), np.log(ANY[1]), count))
        lowered = np.exp(rng.uniform(np.log(ANY[0]), np.log(0.6), count))
        return list(np.where(rng.random(count) < 0.5, raised, lowered).tolist())


def conditions() -> list[Condition]:
    """Return the table's rows."""
    off = {
        "contacts x3": Mismatch(impedance_factor=3.0),
        "reference stale by 5 % of drift": Mismatch(drift_percent=5.0),
        "reference taken stretched by 1 %": Mismatch(reference_stretch=0.01),
        "deformation off by 3 %": Mismatch(scan_stale_deg=5.4),
        "scan noise 0.3 mm": Mismatch(scan_noise_mm=0.3),
        "scan noise 1 mm": Mismatch(scan_noise_mm=1.0),
        "gauge factor +1": Mismatch(gauge_factor=1.0),
        "gauge factor -1": Mismatch(gauge_factor=-1.0),
        "uneven stretch +0.1": Mismatch(unseen_stretch=0.1),
        "lab device, hard touches": replace(LAB, contrast=None, border_mm=0.0),
    }
    return [
        *(Condition(f"1 to 6 units, {noise}", noise=noise) for noise in ("N1", "N2", "N3")),
        *(Condition(f"7 to 12 units, {noise}", noise=noise, counts=(7, 12)) for noise in ("N1", "N2", "N3")),
        Condition("one electrode gone", missing=True),
        *(Condition(f"contrast {contrast:g}", contrast=contrast) for contrast in (0.1, 0.5, 2.0, 10.0, 200.0)),
        Condition("contrasts mixed, of either sign", contrast=None),
        *(Condition(name, mismatch) for name, mismatch in off.items()),
    ]
