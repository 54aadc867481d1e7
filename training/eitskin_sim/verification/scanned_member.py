"""The member of a skin's family that a scan shows, and by how much it may be another: scan and family, joined.

With M the family's modes at some places and L the logarithm of the scan's metric there less the family's mean, the
member's amplitudes, which are about N(0, I), are estimated with one gain, and are off by what that lets through ::

    z = G L     G = (M^T M + (floor^2 + noise^2) I)^-1 M^T

    covariance  G (displaced material + scanner's noise) G^T + (I - G M) (I - G M)^T + STALE^2 I

the last because sheets move after they were scanned. The gain knows nothing of displaced material, which a scan does
not show: weighed by it, the scan's smallest errors would say where material lies. A scan farther from the family than
noise explains shows a sheet beyond it, such as one with a bump.
"""

from typing import Final

import numpy as np

from eitskin_sim.arrays import Array
from eitskin_sim.verification.metric_family import MetricFamily, logarithm, places_of
from eitskin_sim.verification.usual_waves import ScannedShape

STALE: Final = 0.03
"""Standard deviations of every mode by which a sheet has moved since its scan."""

FLOOR: Final = 0.004
"""Of the logarithm of a metric, as a spline through a scan has it."""

MAX_BEYOND: Final = 0.001
"""Root mean square by which the logarithm of a scan's metric may be off the family,"""

MAX_BEYOND_OF_NOISE: Final = 1.35
"""and that for each unit of the scanner's noise in it: nine of ten scans of the family, one of four with bumps."""

MIN_DETERMINANT: Final = 1e-2
"""Of a metric, 1 where nothing is stretched: less than that only folds have."""

STEP: Final = 1e-4
"""Of a derivative of the logarithm."""


def member_of(family: MetricFamily, scanned: ScannedShape) -> MetricFamily | None:
    """Return the family about the member that a scan shows; None where it shows a sheet beyond the family.

    Args:
        family: Of the scanned skin.
        scanned: The scan, and where its material may lie.
    """
    at, none = places_of(family.skin), np.zeros(scanned.stretch.shape[1])
    metric = scanned.metric(none)
    shown, modes = metric(at), family.modes_at_places
    E, F, G = shown.T
    if (E * G - F**2 < MIN_DETERMINANT).any():
        return None  # it folds
    scan = (logarithm(shown) - family.middle).ravel()
    by_material, by_noise, unsure = scanned.rates(none, metric, at)
    material, noise = _logarithms(shown, by_material), _logarithms(shown, by_noise) @ unsure
    noise_rms, every = float(np.sqrt(np.sum(noise**2) / len(scan))), np.eye(modes.shape[1])
    gain = np.linalg.solve(modes.T @ modes + (FLOOR**2 + noise_rms**2) * every, modes.T)
    amplitudes = gain @ scan
    if np.sqrt(np.mean((scan - modes @ amplitudes) ** 2)) > MAX_BEYOND + MAX_BEYOND_OF_NOISE * noise_rms:
        return None
    off = np.hstack([gain @ material, gain @ noise, every - gain @ modes, STALE * every])
    size, way = np.linalg.eigh(off @ off.T)
    return family.about(amplitudes, way * np.sqrt(size))


def _logarithms(metric: Array, rates: Array) -> Array:
    """Return (3 n, m) derivatives of the logarithm of (n, 3) metrics that change by (3, n, m)."""
    by = STEP * np.moveaxis(rates, (0, 2), (2, 0))
    change = (logarithm(metric + by) - logarithm(metric - by)) / (2.0 * STEP)
    return np.asarray(change.reshape(len(by), -1).T)
