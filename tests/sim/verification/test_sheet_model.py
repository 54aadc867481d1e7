"""The model of a scan: all of its noise, a gauge factor that goes with stretch, and models made again about a frame."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.arrays import Array
from eitskin_sim.devices.device import ideal
from eitskin_sim.freeform.sheet import inverted_metric
from eitskin_sim.scene.parts import Bend, LaterChanges
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import fit_cloud, noise_tangents
from eitskin_sim.surface.smoothed import smoothed
from eitskin_sim.verification.constants import DRIFT_SD, ELEMENT_MM, GAUGE_SD, TILT_SD
from eitskin_sim.verification.sheet_model import SheetModel, model_of_cloud

BEND = Bend(angle_deg=100.0, axis_deg=20.0, twist_deg=10.0, stretch_along=1.15)


@pytest.fixture(scope="module")
def cloud() -> Array:
    return np.asarray(measured_cloud(BEND, np.random.default_rng(5), 0.1))


@pytest.fixture(scope="module")
def model(cloud: Array) -> SheetModel:
    return model_of_cloud(cloud)


def amplitudes(model: SheetModel, gauge: float = 0.0, wave: tuple[int, float] | None = None) -> Array:
    """Return amplitudes of all columns that say a gauge factor, and one of the waves."""
    found = np.zeros(model.unseen.columns.shape[1])
    found[model.unseen.n_waves + model.unseen.names.index("gauge")] = gauge / GAUGE_SD
    if wave is not None:
        found[wave[0]] = wave[1]
    return found


@pytest.mark.slow
def test_noise_bends_the_fitted_surface_as_the_fits_of_every_point_say() -> None:
    """Noise of one point at a time, through the fit itself, adds up to the same covariance."""
    at = np.array([[3.0, 4.0], [75.0, 50.0], [140.0, 90.0], [20.0, 80.0]])
    rows, columns = PAPER.grid.shape
    by_x, by_y = [], []
    for point in range(rows * columns):
        cloud = np.zeros((3, rows * columns))
        cloud[0, point] = 1.0
        x, y = fit_cloud(cloud.reshape(3, rows, columns), PAPER.grid).tangents(at)
        by_x.append(x[:, 0])
        by_y.append(y[:, 0])
    dx, dy = np.array(by_x), np.array(by_y)
    along_x, along_y = noise_tangents(at)
    assert along_x @ along_x.T == pytest.approx(dx.T @ dx, rel=1e-6, abs=1e-12)
    assert along_y @ along_y.T == pytest.approx(dy.T @ dy, rel=1e-6, abs=1e-12)
    assert along_x @ along_y.T == pytest.approx(dx.T @ dy, rel=1e-6, abs=1e-12)


@pytest.mark.slow
def test_the_scans_columns_are_the_scatter_of_models_of_noisy_scans(cloud: Array, model: SheetModel) -> None:
    """Scans drawn with noise, smoothed, scatter in voltages as the columns say, within a third.

    The strength of the prior is found anew of each scan, and is one for all of the sheet.
    """
    known = len(model.unseen.names) + model.unseen.n_waves
    columns = model.unseen.columns[:, known:] / model.touched.untouched_V[:, None]
    true = np.asarray(measured_cloud(BEND, None), dtype=np.float64)
    untouched = inverted_metric(fit_cloud(true).metric, ELEMENT_MM).untouched_V
    rng = np.random.default_rng(8)
    drawn = []
    for _ in range(16):
        noisy = fit_cloud(true + 0.1 * rng.standard_normal(cloud.shape))
        drawn.append(np.log(inverted_metric(smoothed(noisy, 0.1).surface.metric, ELEMENT_MM).untouched_V / untouched))
    stated = np.sqrt(np.square(columns).sum(axis=1))
    found = np.sqrt(np.mean(np.square(drawn), axis=0))
    assert np.median(found / stated) == pytest.approx(1.0, abs=0.35)


@pytest.mark.slow
def test_a_model_made_again_about_a_gauge_factor_is_that_of_such_a_sheet(model: SheetModel) -> None:
    again = model.about(amplitudes(model, gauge=1.0))
    stated = ideal(PAPER)
    device = replace(stated, sheet=replace(stated.sheet, gauge_factor=1.0))
    true = inverted_metric(model.metric, ELEMENT_MM, None, device)
    assert again.touched.untouched_V == pytest.approx(
        true.untouched_V, rel=2e-5
    )  # a metric that is moved by nothing is a spline still
    assert np.abs(np.log(true.untouched_V / model.touched.untouched_V)).max() > 0.02
    waves, gauge = again.beyond(amplitudes(model, gauge=1.2))
    assert np.abs(waves).max() < 1e-12
    assert gauge == pytest.approx(0.2)


def untouched_V(model: SheetModel, **changed: object) -> Array:
    """Return (104,) V of the model's metric, its layer changed: by the forward model alone."""
    stated = ideal(PAPER)
    device = replace(stated, sheet=replace(stated.sheet, **changed))
    return np.asarray(inverted_metric(model.metric, ELEMENT_MM, None, device).untouched_V)


def test_the_layers_columns_are_the_forward_models_derivatives(model: SheetModel) -> None:
    """Of one standard deviation each; tilts as far as the two of them make a plane of any direction.

    Within 1.5 %: columns leave the contacts as they are, which pass 1 % otherwise on a layer that conducts otherwise.
    """
    step, nominal = 1e-3, untouched_V(model)
    names = model.unseen.names
    column = {name: model.unseen.columns[:, model.unseen.n_waves + names.index(name)] for name in names}
    drifted = (untouched_V(model, late=LaterChanges(factor=1.0 + step)) - nominal) / np.log(1.0 + step)
    stretched = (untouched_V(model, gauge_factor=step) - nominal) / step
    for found, expected in ((column["drift"], DRIFT_SD * drifted), (column["gauge"], GAUGE_SD * stretched)):
        assert np.linalg.norm(found - expected) < 0.015 * np.linalg.norm(expected)
    tilted = TILT_SD * (untouched_V(model, late=LaterChanges(gradient_rms=step, seed=5)) - nominal) / step
    two = np.stack([column["tilt x"], column["tilt y"]], axis=-1)
    share = np.linalg.lstsq(two, tilted, rcond=None)[0]
    assert np.linalg.norm(tilted - two @ share) < 0.015 * np.linalg.norm(tilted)
    assert np.linalg.norm(share) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("gauge", [0.0, 1.0])
@pytest.mark.parametrize("wave", [0, 4])
def test_waves_answer_as_a_sheet_with_them_does_whatever_the_gauge_factor(
    model: SheetModel, gauge: float, wave: int
) -> None:
    """A quotient of two models: with a gauge factor, conductivity follows the stretch that a wave brings.

    Within 3 %: the column takes slopes of the metric over 1 mm, of a spline between points 2.5 mm apart.
    """
    step = 0.02
    high, low = (model.about(amplitudes(model, gauge, (wave, sign * step))) for sign in (1.0, -1.0))
    quotient = (high.touched.untouched_V - low.touched.untouched_V) / (2.0 * step)
    column = model.about(amplitudes(model, gauge)).unseen.columns[:, wave]
    assert np.linalg.norm(column - quotient) < 0.03 * np.linalg.norm(quotient)
