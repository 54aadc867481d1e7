"""The surface that a scan shows: nearer than a fit, as unsure as it says, and with its bumps."""

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.arrays import Array
from eitskin_sim.scene.parts import Bend
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import fit_cloud
from eitskin_sim.surface.smoothed import Scan, smoothed

NOISE_MM = 0.1
PLACES = np.stack([one.ravel() for one in np.meshgrid(np.linspace(0, 150, 19), np.linspace(0, 100, 13))], axis=-1)
PLAIN = Bend(angle_deg=120.0, axis_deg=15.0, twist_deg=10.0, stretch_along=1.1)
BUMPED = Bend(angle_deg=60.0, bumps_mm=((40.0, 50.0, 6.0, 15.0), (110.0, 35.0, -6.0, 20.0)))


def scans(bend: Bend, seed: int) -> tuple[Array, Array, Scan]:
    """Return how far the metric of a fit and of the smoothed surface are off, (n, 3), and the scan."""
    clean = np.asarray(measured_cloud(bend, None), dtype=np.float64)
    noisy = fit_cloud(clean + NOISE_MM * np.random.default_rng(seed).standard_normal(clean.shape))
    scan, true = smoothed(noisy, NOISE_MM), fit_cloud(clean).metric(PLACES)
    return noisy.metric(PLACES) - true, scan.surface.metric(PLACES) - true, scan


@pytest.mark.parametrize(("bend", "most"), [(PLAIN, 0.4), (BUMPED, 0.85)])
def test_a_smoothed_metric_is_nearer_to_the_surface_than_a_fit(bend: Bend, most: float) -> None:
    fitted, found = (np.array(one) for one in list(zip(*(scans(bend, seed) for seed in range(6)), strict=True))[:2])
    assert np.sqrt(np.mean(found**2)) < most * np.sqrt(np.mean(fitted**2))


@pytest.mark.parametrize("bend", [PLAIN, BUMPED])
def test_a_smoothed_metric_is_as_unsure_as_it_says(bend: Bend) -> None:
    """By root mean square over all places and draws, within a half: the prior is one strength for all of the sheet."""
    off, said = [], []
    for seed in range(6):
        _, found, scan = scans(bend, seed)
        off.append(found)
        said.append(np.sum((scan.rates(PLACES) @ scan.unsure) ** 2, axis=-1))
    assert np.sqrt(np.mean(np.square(off)) / np.mean(said)) == pytest.approx(1.0, abs=0.5)


def test_rates_are_quotients_of_the_metrics_of_moved_surfaces() -> None:
    """A cloud moved a little at every point changes the metric as some mixture of the ways says, and by no more."""
    cloud = np.asarray(measured_cloud(PLAIN, None), dtype=np.float64)
    surface = fit_cloud(cloud)
    scan = Scan(surface, np.zeros((surface.coefficients.size, 0)), PAPER.grid)
    rates = scan.rates(PLACES)
    assert rates.shape == (3, len(PLACES), 3 * scan.surface.coefficients[..., 0].size)
    rng = np.random.default_rng(3)
    step = 1e-4 * rng.standard_normal(cloud.shape)
    high, low = (fit_cloud(cloud + sign * step).metric(PLACES) for sign in (1.0, -1.0))
    quotient = (high - low).T.ravel() / 2.0
    flat = rates.reshape(-1, rates.shape[-1])
    along = np.linalg.lstsq(flat, quotient, rcond=None)[0]
    assert np.linalg.norm(flat @ along - quotient) < 1e-5 * np.linalg.norm(quotient), "the ways of noise are all there"
