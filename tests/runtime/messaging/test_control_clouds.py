"""Clouds as control requests: arrays and files; the runtime checks once whether they can be of its sheet."""

import msgpack
import numpy as np
import pytest

import eitskin
from eitskin_proto.skin import cloud_file
from eitskin_proto.skin.cloud import flat_cloud


def test_a_cloud_with_predictions_arrives_as_it_was_sent(server, recorder):
    rng = np.random.default_rng(0)
    cloud, predicted, flat = (
        flat_cloud() + 0.1 * rng.normal(size=(3, 30, 45)),
        rng.normal(size=104),
        rng.normal(size=104),
    )
    assert eitskin.send_cloud(server.endpoint, cloud, predicted, flat) == 1
    got, got_predicted, got_flat = recorder.clouds[0]
    assert np.array_equal(got, cloud.astype(np.float32))
    assert np.array_equal(got_predicted, predicted)
    assert np.array_equal(got_flat, flat)
    assert eitskin.send_cloud(server.endpoint, cloud) == 2
    assert recorder.clouds[1][1:] == (None, None)


def test_bad_clouds_are_value_errors_before_anything_is_sent(server, recorder):
    cloud = flat_cloud()
    cloud[0, 1, 2] = np.nan
    with pytest.raises(ValueError, match=r"cloud\[0, 1, 2\] is nan, expected a finite number"):
        eitskin.send_cloud(server.endpoint, cloud)
    with pytest.raises(ValueError, match=r"\(30, 45, 3\)"):
        eitskin.send_cloud(server.endpoint, np.zeros((30, 45, 3)))
    with pytest.raises(ValueError, match="100000 mm"):
        eitskin.send_cloud(server.endpoint, flat_cloud() * 1e6)
    with pytest.raises(ValueError, match=r"predicted\[3\] is inf"):
        eitskin.send_cloud(server.endpoint, flat_cloud(), np.where(np.arange(104) == 3, np.inf, 1.0))
    assert recorder.clouds == []


def test_clouds_that_cannot_be_of_this_sheet_are_refused_by_the_runtime_which_says_why(server, raw, recorder):
    with pytest.raises(eitskin.ControlError, match="is 300 mm along x"):
        eitskin.send_cloud(server.endpoint, 2 * flat_cloud())
    answer = raw(msgpack.packb({"command": "cloud", "cloud": (2 * flat_cloud()).astype("<f4").tobytes()}))
    assert answer["ok"] is False
    assert "is 300 mm along x and 200 mm along y, expected 120 to 240 and 75 to 140 mm" in answer["error"]
    assert recorder.clouds == []


def test_a_cloud_file_brings_its_prediction_along(server, recorder, tmp_path):
    predicted, flat = np.arange(104.0), np.ones(104)
    cloud_file.save_surface(tmp_path / "cloud.npz", cloud_file.Surface(flat_cloud(), predicted, flat))
    assert eitskin.send_cloud(server.endpoint, tmp_path / "cloud.npz") == 1
    assert eitskin.send_cloud(server.endpoint, cloud_file.load_surface(tmp_path / "cloud.npz")) == 2
    for got, got_predicted, got_flat in recorder.clouds:
        assert np.array_equal(got, flat_cloud().astype(np.float32))
        assert np.array_equal(got_predicted, predicted)
        assert np.array_equal(got_flat, flat)
    cloud_file.save_surface(tmp_path / "bare.npz", cloud_file.Surface(flat_cloud()))
    eitskin.send_cloud(server.endpoint, str(tmp_path / "bare.npz"))
    assert recorder.clouds[2][1:] == (None, None)
    with pytest.raises(cloud_file.CloudFileError, match=r"nobody\.npz cannot be read: No such file"):
        eitskin.send_cloud(server.endpoint, tmp_path / "nobody.npz")
