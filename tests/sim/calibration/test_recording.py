"""A recording says what is wrong with it in one line."""

import numpy as np
import pytest

from eitskin_proto.errors import MismatchError
from eitskin_proto.files.reading import FileError
from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.calibration.recording import RecordingError, load_recording

WHOLE = {
    "reference_V": np.ones(208),
    "reference_frames": np.array(100),
    "notes": np.array("of ours"),
}


def written(tmp_path, **changes):
    path = tmp_path / "r.npz"
    np.savez(path, **{name: value for name, value in {**WHOLE, **changes}.items() if value is not None})
    return path


def test_the_reference_is_taken_and_other_arrays_are_left_alone(tmp_path):
    found = load_recording(written(tmp_path), PAPER)
    assert (len(found.reference_V), found.frames) == (208, 100)


def test_a_reference_alone_will_do(tmp_path):
    path = tmp_path / "r.npz"
    np.savez(path, reference_V=np.ones(104))
    assert load_recording(path, PAPER).frames == 1


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"reference_V": None}, r"lacks reference_V; found"),
        ({"reference_V": np.ones(103)}, r"reference_V has shape \(103,\), expected \(104,\), or \(208,\)"),
        ({"reference_V": np.array(["a"] * 104)}, r"reference_V holds <U1, expected real numbers"),
        ({"reference_V": np.where(np.arange(104) == 5, np.nan, 1.0)}, r"reference_V\[5\] is nan, expected finite"),
        ({"reference_V": np.where(np.arange(104) == 5, 0.0, 1.0)}, r"row 5 is 0 V: is its electrode connected"),
        ({"reference_cloud_mm": flat_cloud()}, "calibrate from a reference taken flat"),
        ({"reference_frames": np.array(0)}, "expected one number from 1 on"),
        ({"reference_frames": np.array(1.0)}, "reference_frames is float64"),
    ],
)
def test_what_cannot_be_used_is_refused(tmp_path, changes, text):
    with pytest.raises(RecordingError, match=text):
        load_recording(written(tmp_path, **changes), PAPER)


def test_another_skin_or_protocol_is_refused(tmp_path):
    with pytest.raises(MismatchError, match=r"grid_id: found feed, expected .*record it again"):
        load_recording(written(tmp_path, grid_id=np.array("feed")), PAPER)
    with pytest.raises(MismatchError, match="protocol_id: found feed"):
        load_recording(written(tmp_path, protocol_id=np.array("feed")), PAPER)
    (tmp_path / "r.npz").write_bytes(b"no archive")
    with pytest.raises(FileError, match=r"r\.npz"):
        load_recording(tmp_path / "r.npz", PAPER)
