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
    "voltages_V": np.ones((3, 104)),
    "frames": np.array([10, 20, 30]),
    "kind": np.array(["untouched", "single", "untouched"]),
    "cloud_mm": flat_cloud()[None],
    "cloud_index": np.array([0, -1, -1]),
    "notes": np.array("of ours"),
}


def written(tmp_path, **changes):
    path = tmp_path / "r.npz"
    np.savez(path, **{name: value for name, value in {**WHOLE, **changes}.items() if value is not None})
    return path


def test_untouched_moments_are_taken_and_others_counted(tmp_path):
    found = load_recording(written(tmp_path), PAPER)
    assert (len(found.reference.voltages_V), found.reference.frames, found.reference.cloud_mm) == (208, 100, None)
    assert [one.frames for one in found.untouched] == [10, 30]
    assert [one.cloud_mm is None for one in found.untouched] == [False, True]
    assert found.left_out == 1


def test_a_reference_alone_will_do(tmp_path):
    path = tmp_path / "r.npz"
    np.savez(path, reference_V=np.ones(104))
    assert load_recording(path, PAPER).untouched == ()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"reference_V": None}, r"lacks reference_V; found"),
        ({"reference_V": np.ones(103)}, r"reference_V has shape \(103,\), expected \(104,\), or \(208,\)"),
        ({"reference_V": np.array(["a"] * 104)}, r"reference_V holds <U1, expected real numbers"),
        ({"reference_V": np.where(np.arange(104) == 5, np.nan, 1.0)}, r"reference_V\[5\] is nan, expected finite"),
        ({"reference_V": np.where(np.arange(104) == 5, 0.0, 1.0)}, r"row 5 is 0 V: is its electrode connected"),
        ({"voltages_V": np.ones((3, 50))}, r"voltages_V\[0\] has shape \(50,\)"),
        ({"voltages_V": np.ones(104)}, r"voltages_V has shape \(104,\), expected \(n, 104\)"),
        ({"kind": None}, "lacks kind: expected 3 texts"),
        ({"kind": np.array(["untouched"])}, r"kind is .* of shape \(1,\), expected texts \(3,\)"),
        ({"cloud_index": np.array([0, 1, -1])}, "cloud_index names cloud 1, expected -1 to 0"),
        ({"cloud_mm": np.ones((3, 30, 45))}, r"cloud_mm has shape \(3, 30, 45\), expected \(k, 3, 30, 45\)"),
        ({"cloud_mm": 9.0 * flat_cloud()[None]}, r"cloud_mm\[0\]: "),
        ({"reference_cloud_mm": np.full((3, 30, 45), np.inf)}, r"reference_cloud_mm\[0, 0, 0\] is inf"),
        ({"frames": np.array([0, 1, 1])}, "expected at least 1 frame"),
        ({"frames": np.array([1.0, 1.0, 1.0])}, "frames is float64"),
    ],
)
def test_what_cannot_be_used_is_refused(tmp_path, changes, text):
    with pytest.raises(RecordingError, match=text):
        load_recording(written(tmp_path, **changes), PAPER)


def test_another_skin_or_protocol_is_refused(tmp_path):
    with pytest.raises(MismatchError, match=r"skin_digest: found feed, expected .*record it again"):
        load_recording(written(tmp_path, skin_digest=np.array("feed"), grid_id=np.array(PAPER.grid_id)), PAPER)
    with pytest.raises(MismatchError, match="protocol_id: found feed"):
        load_recording(written(tmp_path, protocol_id=np.array("feed")), PAPER)
    (tmp_path / "r.npz").write_bytes(b"no archive")
    with pytest.raises(FileError, match=r"r\.npz"):
        load_recording(tmp_path / "r.npz", PAPER)
