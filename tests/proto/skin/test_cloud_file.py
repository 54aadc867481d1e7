import numpy as np
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.cloud_file import CloudFileError, Surface, load_surface, save_surface


def test_a_surface_comes_back_as_it_was_with_and_without_a_prediction(tmp_path):
    predicted, flat = np.arange(104.0), np.ones(104)
    save_surface(tmp_path / "both.npz", Surface(flat_cloud(), predicted, flat), {"corner": "given"})
    found = load_surface(tmp_path / "both.npz")
    assert np.array_equal(found.cloud_mm, flat_cloud())
    assert np.array_equal(found.predicted_V, predicted)
    assert np.array_equal(found.predicted_flat_V, flat)
    save_surface(tmp_path / "cloud.npz", Surface(flat_cloud()))
    assert load_surface(tmp_path / "cloud.npz").predicted_V is None


def test_a_file_that_is_no_cloud_is_refused_and_named_with_the_command(tmp_path):
    np.savez(tmp_path / "other.npz", cloud=np.zeros((3, 30, 45)))
    np.save(tmp_path / "array.npy", np.zeros(3))
    (tmp_path / "junk.npz").write_bytes(b"not a zip")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "other.npz").read_bytes()[:400])
    save_surface(tmp_path / "short.npz", Surface(flat_cloud(), np.zeros(7), np.zeros(104)))
    for name in ("other.npz", "array.npy", "junk.npz", "cut.npz", "short.npz", "nobody.npz"):
        with pytest.raises(CloudFileError, match=rf"{name}.*eitskin surface"):
            load_surface(tmp_path / name)


TURN = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def test_a_cloud_knows_where_its_points_were_measured_and_without_that_stays_where_it_is(tmp_path):
    measured = np.einsum("ji,jrc->irc", TURN, flat_cloud() - np.array([1.0, 2.0, 90_000.0])[:, None, None])
    save_surface(tmp_path / "cloud.npz", Surface(flat_cloud(), None, None, TURN, np.array([1.0, 2.0, 90_000.0])))
    found = load_surface(tmp_path / "cloud.npz")
    assert np.array_equal(found.cloud_mm, flat_cloud())
    assert np.abs(found.measured_mm - measured).max() < 1e-9
    save_surface(tmp_path / "bare.npz", Surface(flat_cloud()))
    assert np.array_equal(load_surface(tmp_path / "bare.npz").measured_mm, flat_cloud())


@pytest.mark.parametrize(
    ("rotation", "translation", "text"),
    [
        (1.001 * TURN, np.zeros(3), "stretches or mirrors"),
        (-TURN, np.zeros(3), "stretches or mirrors"),
        (np.full((3, 3), np.nan), np.zeros(3), "stretches or mirrors"),
        (TURN[:2], np.zeros(3), r"\(2, 3\) and a translation \(3,\)"),
        (TURN, np.full(3, np.inf), "expected finite"),
        (TURN, np.full(3, 1e6), "100000 mm from the origin"),
    ],
)
def test_a_pose_that_no_scanner_has_is_refused(tmp_path, rotation, translation, text):
    save_surface(tmp_path / "cloud.npz", Surface(flat_cloud(), None, None, rotation, translation))
    with pytest.raises(CloudFileError, match=text):
        load_surface(tmp_path / "cloud.npz")
