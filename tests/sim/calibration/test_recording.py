"""A recording says what is wrong with it in one line."""

from dataclasses import replace

import numpy as np
import pytest
from tests.second_skin import SECOND

from eitskin_proto.errors import MismatchError
from eitskin_proto.files.reading import FileError
from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import named
from eitskin_sim.calibration.recording import RecordingError, load_recording

WHOLE = {
    "reference_V": np.ones(208),
    "reference_frames": np.array(100),
    "notes": np.array("of ours"),
}


NAN = flat_cloud()
NAN[0, 2, 3] = np.nan


def written(tmp_path, **changes):
    path = tmp_path / "r.npz"
    np.savez(path, **{name: value for name, value in {**WHOLE, **changes}.items() if value is not None})
    return path


def test_the_reference_is_taken_and_other_arrays_are_left_alone(tmp_path):
    found = load_recording(written(tmp_path), PAPER)
    assert (len(found.reference_V), found.frames) == (208, 100)


def test_the_scan_of_the_reference_is_taken_with_it(tmp_path):
    assert load_recording(written(tmp_path), PAPER).cloud_mm is None
    cloud = 1.03 * flat_cloud()
    assert np.array_equal(load_recording(written(tmp_path, reference_cloud_mm=cloud), PAPER).cloud_mm, cloud)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"reference_V": None}, r"lacks reference_V; found"),
        ({"reference_V": np.ones(103)}, r"reference_V has shape \(103,\), expected \(104,\), or \(208,\)"),
        ({"reference_V": np.where(np.arange(104) == 5, np.nan, 1.0)}, r"reference_V\[5\] is nan, expected finite"),
        ({"reference_V": np.where(np.arange(104) == 5, 0.0, 1.0)}, r"row 5 is 0 V: is its electrode connected"),
        (
            {"reference_cloud_mm": 1e-3 * flat_cloud()},
            "reference_cloud_mm: the cloud's sheet is .* in mm; leave it out if the sheet lay flat",
        ),
        ({"reference_frames": np.array(0)}, "reference_frames is 0, expected one whole number from 1 on"),
    ],
)
def test_what_cannot_be_used_is_refused(tmp_path, changes, text):
    with pytest.raises(RecordingError, match=text):
        load_recording(written(tmp_path, **changes), PAPER)


def test_ids_may_be_bytes_as_in_other_measured_files(tmp_path):
    ids = {"grid_id": np.array(PAPER.grid_id.encode()), "skin_digest": np.array(PAPER.digest.encode())}
    assert len(load_recording(written(tmp_path, **ids), PAPER).reference_V) == 208


def test_another_skin_or_protocol_is_refused(tmp_path):
    with pytest.raises(MismatchError, match=r"grid_id: found feed, expected .*record it again"):
        load_recording(written(tmp_path, grid_id=np.array("feed")), PAPER)
    with pytest.raises(MismatchError, match="protocol_id: found feed"):
        load_recording(written(tmp_path, protocol_id=np.array("feed")), PAPER)
    (tmp_path / "r.npz").write_bytes(b"no archive")
    with pytest.raises(FileError, match=r"r\.npz"):
        load_recording(tmp_path / "r.npz", PAPER)


def test_a_digest_alone_must_be_the_skin_s_or_that_of_what_it_was_calibrated_from(tmp_path):
    foreign = "0123456789abcdef"
    twin = replace(named("lab"), calibrated_from=foreign, stated_grid_id=PAPER.grid_id)
    for digest, skin in ((PAPER.digest, PAPER), (foreign, twin), (twin.digest, twin)):
        load_recording(written(tmp_path, skin_digest=np.array(digest)), skin)
    expected = (
        rf"skin_digest: found {foreign}, expected {PAPER.digest} \(paper\); without grid_id .*; store grid_id too, or"
    )
    with pytest.raises(MismatchError, match=expected):
        load_recording(written(tmp_path, skin_digest=np.array(foreign)), PAPER)
    with pytest.raises(MismatchError, match="skin_digest"):
        load_recording(written(tmp_path, skin_digest=np.array(PAPER.digest)), SECOND)
    load_recording(written(tmp_path, skin_digest=np.array(foreign), grid_id=np.array(PAPER.grid_id)), PAPER)


LATER = {
    "bent_V": np.ones((2, 208)),
    "bent_cloud_mm": np.array([flat_cloud()] * 2),
    "bent_frames": np.array(20),
    "press_V": np.ones((3, 104)),
    "press_xy_mm": np.array([[40.0, 30.0], [75.0, 50.0], [110.0, 70.0]]),
    "stamp_mm": np.array([16.0]),
}


def test_bent_moments_and_presses_are_taken_with_what_belongs_to_them(tmp_path):
    found = load_recording(written(tmp_path, **LATER), PAPER)
    assert [len(one.voltages_V) for one in found.bents] == [104, 104], "of 208 rows the 104 are kept"
    assert (found.bents[0].frames, found.presses[0].frames) == (20, 1)
    assert found.presses[1].xy_mm.tolist() == [75.0, 50.0]
    assert found.presses[1].stamp_mm == (16.0,)
    rectangle = load_recording(written(tmp_path, **LATER | {"stamp_mm": np.array([20.0, 10.0])}), PAPER)
    assert rectangle.presses[0].stamp_mm == (20.0, 10.0)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"bent_cloud_mm": None}, "has bent_V without bent_cloud_mm; expected bent_V, bent_cloud_mm, or none of them"),
        ({"bent_V": np.ones((2, 103))}, r"bent_V has shape \(2, 103\), expected \(n, 104\) or \(n, 208\), n from 1"),
        ({"press_V": np.full((3, 104), np.nan)}, r"press_V\[0, 0\] is nan, expected finite numbers"),
        ({"press_xy_mm": np.full((3, 2), 120.0)}, r"press_xy_mm\[0\] is \(120, 120\), expected a place on the sheet"),
        ({"stamp_mm": np.array([0.5])}, "stamp_mm is 0.5, expected a disc's diameter, or a length and a width, from 3"),
    ],
)
def test_moments_that_cannot_be_used_are_refused(tmp_path, changes, text):
    with pytest.raises(RecordingError, match=text):
        load_recording(written(tmp_path, **LATER | changes), PAPER)
