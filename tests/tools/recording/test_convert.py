"""A recording in other programs' files: the same voltages, clouds and maps."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitskin import Frame
from eitskin_tools.recording.convert.files import write_npz, write_parquet
from eitskin_tools.recording.convert.table import table_of
from eitskin_tools.recording.recorder import Kept
from eitskin_tools.recording.script import Script

from .conftest import CLOUD, VOLTS, recorded, scans


@pytest.fixture
def with_maps(tmp_path: Path, items: list[Any]) -> Path:
    recorded(tmp_path / "maps.mcap", items, Kept(maps=True))
    return tmp_path / "maps.mcap"


def volts() -> np.ndarray:
    return np.array([np.frombuffer(step.frame.payload, "<i4", 104, 20) * VOLTS for step in scans(150)])


def test_npz_has_what_was_measured_and_published(with_maps: Path, items: list[Any], tmp_path: Path) -> None:
    script = Script(with_maps)
    write_npz(tmp_path / "a.npz", table_of(script), script)
    with np.load(tmp_path / "a.npz") as found:
        np.testing.assert_allclose(found["voltages_V"], volts(), rtol=1e-12)
        frames = [item for item in items if isinstance(item, Frame)]
        assert found["seq"].tolist() == [frame.sequence for frame in frames]
        assert found["map"].tobytes() == np.array([frame.map for frame in frames]).tobytes()
        index = found["cloud_index"]
        assert found["cloud_mm"][index[-1]].tobytes() == CLOUD.astype("<f4").tobytes()
        assert index.tolist() == sorted(index.tolist())
        assert str(found["serial"]) == "TEST-1"


def test_evaluate_measured_reads_npz_and_recordings_alike(with_maps: Path, tmp_path: Path) -> None:
    from eitskin_tools.evaluation.measured_file import load_measured

    script = Script(with_maps)
    write_npz(tmp_path / "a.npz", table_of(script), script)
    one, other = load_measured(tmp_path / "a.npz"), load_measured(with_maps)
    assert one.voltages_V.tobytes() == other.voltages_V.tobytes()
    assert one.clouds_mm.tobytes() == other.clouds_mm.tobytes()
    assert one.cloud_index.tolist() == other.cloud_index.tolist()
    assert set(other.kinds) == {"touched", "untouched"}


@pytest.mark.slow  # its package comes with the slow tests
def test_parquet_has_the_same(with_maps: Path, tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet", reason="extra: parquet")
    script = Script(with_maps)
    table = table_of(script)
    write_parquet(tmp_path / "a.parquet", table, script)
    found = pq.read_table(tmp_path / "a.parquet")
    assert found.num_rows == 150
    np.testing.assert_array_equal(np.array(found["voltages_V"].to_pylist()), table.voltages_V)
    assert found["seq"].to_pylist() == table.columns["seq"].tolist()
    assert found.schema.metadata[b"serial"] == b"TEST-1"


@pytest.mark.slow  # the same
def test_rosbag2_has_standard_messages_that_are_the_same(with_maps: Path, items: list[Any], tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="extra: ros")
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    from eitskin_tools.recording.convert.rosbag import write_rosbag

    script, store = Script(with_maps), get_typestore(Stores.ROS2_JAZZY)
    count = write_rosbag(tmp_path / "bag", script)
    rows, clouds, maps = [], [], []
    with Reader(tmp_path / "bag") as bag:
        assert bag.message_count == count
        for connection, _, raw in bag.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            if connection.topic == "/eitskin/voltages":
                rows.append(np.frombuffer(message.data.tobytes(), "<f8"))
            elif connection.topic == "/eitskin/surface":
                clouds.append(np.frombuffer(message.data.tobytes(), "<f4").reshape(-1, 3))
            elif connection.topic == "/eitskin/map":
                maps.append((message.height, message.width, message.data.tobytes()))
    np.testing.assert_allclose(np.array(rows), volts(), rtol=1e-12)
    np.testing.assert_allclose(clouds[-1].T.reshape(3, 30, 45) * 1e3, CLOUD, rtol=1e-5, atol=1e-4)
    known = {frame.map.tobytes() for frame in items if isinstance(frame, Frame)}
    assert {data for _, _, data in maps} <= known
    assert {(rows, columns) for rows, columns, _ in maps} == {(30, 45)}
