"""The predicted reference: exact where a cloud shows everything, with its error stated where it cannot."""

import errno

import numpy as np
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.dataset import prediction_cache
from eitskin_sim.dataset.reader import DataSet
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.bend import metric, surface
from eitskin_sim.scene.scene import Bend, Scene, Sheet
from eitskin_sim.scene.touch_table import TouchTable
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import fit_cloud, flat_voltages, predict, predicted_log

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


def a_data_set(digest):
    clouds = np.stack([measured_cloud(bend) for bend in (Bend(), EVEN)])
    none = np.zeros(0)
    return DataSet(
        set_name="free",
        seed=0,
        digest=digest,
        reference_V=none,
        untouched_V=none,
        clouds=clouds,
        bends=(),
        deformation_split=(),
        voltages_V=none,
        deformation=none,
        touch_set=none,
        touch_split=none,
        units=none,
        free=TouchTable(np.empty((0, 7)), np.zeros(1, dtype=np.int64)),
    )


def test_predictions_of_a_data_set_are_computed_once_and_again_for_another(tmp_path, monkeypatch):
    first = prediction_cache.predicted_log_of(tmp_path, a_data_set("one"))
    assert np.array_equal(first, predicted_log(a_data_set("one").clouds))
    assert [path.name for path in tmp_path.iterdir()] == ["predicted.npz"]
    with monkeypatch.context() as patch:
        patch.setattr(prediction_cache, "predicted_log", lambda clouds, skin: np.full((len(clouds), 104), 7.0))
        assert np.array_equal(prediction_cache.predicted_log_of(tmp_path, a_data_set("one")), first)
        assert (prediction_cache.predicted_log_of(tmp_path, a_data_set("two")) == 7.0).all()
        patch.setattr(prediction_cache, "model", lambda skin: "another")
        assert (prediction_cache.predicted_log_of(tmp_path, a_data_set("one")) == 7.0).all()


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC, errno.EACCES])
def test_where_nothing_can_be_kept_predictions_are_computed_all_the_same(tmp_path, monkeypatch, number):
    def refuse(*_):
        raise OSError(number, "no")

    monkeypatch.setattr(prediction_cache, "replacing", refuse)
    monkeypatch.setattr(prediction_cache, "predicted_log", lambda clouds, skin: np.full((len(clouds), 104), 7.0))
    assert (prediction_cache.predicted_log_of(tmp_path, a_data_set("one")) == 7.0).all()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("content", [b"", b"junk", b"PK\x03\x04 broken"])
def test_broken_file_of_predictions_is_made_again(tmp_path, content):
    (tmp_path / "predicted.npz").write_bytes(content)
    found = prediction_cache.predicted_log_of(tmp_path, a_data_set("one"))
    assert np.array_equal(found, prediction_cache.predicted_log_of(tmp_path, a_data_set("one")))
    assert np.load(tmp_path / "predicted.npz")["digest"] == "one"
