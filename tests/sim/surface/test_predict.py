"""The predicted reference: exact where a cloud shows everything, with its error stated where it cannot."""

import numpy as np
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.bend import metric, surface
from eitskin_sim.scene.scene import Bend, Scene, Sheet
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import fit_cloud, flat_voltages, predict

EVEN = Bend(angle_deg=120, axis_deg=20, skew=0.4, stretch_along=1.12, stretch_across=0.97)


def error(bend, rng=None):
    truth = solve_scene(Scene(bend=bend, element_size_mm=2.5)).voltages
    return float(np.sqrt(np.mean((predict(measured_cloud(bend, rng)) / truth - 1) ** 2)))


def test_flat_cloud_predicts_the_flat_voltages():
    # 2e-4 is what element_size_mm 4.5 is off; the correction takes that away on the flat sheet.
    assert np.allclose(predict(flat_cloud()), flat_voltages(), rtol=1e-9)


def test_evenly_stretched_bend_is_predicted_within_a_thousandth():
    assert error(EVEN) < 1e-3


def test_scan_noise_costs_less_than_a_hundredth_and_a_half():
    assert error(EVEN, np.random.default_rng(1)) < 1.5e-2


def test_any_pose_gives_the_same_prediction():
    cloud = measured_cloud(EVEN).astype(np.float64)
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = np.einsum("ij,jrc->irc", turn, cloud) + 40.0
    assert np.allclose(predict(moved), predict(cloud), rtol=1e-9)


def test_spline_follows_points_and_metric_of_a_known_surface():
    xy = PAPER.grid.pixel_centres_mm().reshape(-1, 2)
    cloud = surface(EVEN, Sheet(), xy).T.reshape(3, 30, 45)
    fitted = fit_cloud(cloud)
    inner = np.random.default_rng(0).uniform((2, 2), (148, 98), (200, 2))
    assert np.abs(fitted.points(inner) - surface(EVEN, Sheet(), inner)).max() < 0.01
    assert np.abs(fitted.metric(inner) - metric(EVEN, Sheet(), inner)).max() < 3e-3


@pytest.mark.parametrize("cloud", [np.zeros((3, 45, 30)), np.full((3, 30, 45), np.nan)])
def test_malformed_cloud_is_refused(cloud):
    with pytest.raises(ValueError, match="cloud"):
        predict(cloud)
