"""A recording in other programs' files: the same voltages, clouds and maps."""

import csv
import json
import struct
from collections import Counter
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.runtime.pipeline.test_taught_pipeline import MIX, response, taught_bundle

from eitskin import Frame
from eitskin.messaging.streams.measured import WireFrame
from eitskin.messaging.streams.state import SkinState
from eitskin.model.bundle import load_bundle
from eitskin.reference.captured import stored
from eitskin_proto.wire.frames import Frame as WireScan
from eitskin_tools import cli
from eitskin_tools.recording.convert import Table, table_of, write_npz, write_parquet
from eitskin_tools.recording.frames import RecordedFrames
from eitskin_tools.recording.layout import CLOUD as CLOUDS
from eitskin_tools.recording.layout import MAP, STATE
from eitskin_tools.recording.recorder import RecorderOptions
from eitskin_tools.recording.reinfer import reinfer
from eitskin_tools.recording.resample import resampled
from eitskin_tools.recording.script import Script, Step

from .conftest import CLOUD, PERIOD_NS, TINY, VOLTS, counts, measured, recorded, reference, scans


@pytest.fixture(scope="module")
def items() -> list[Any]:
    """What streams and frames say, with the touches."""
    return measured(skip_unchanged=True, touches=True)


@pytest.fixture
def with_maps(tmp_path: Path, items: list[Any]) -> Path:
    recorded(tmp_path / "maps.mcap", items, RecorderOptions(maps=True))
    return tmp_path / "maps.mcap"


def computed(script: Script) -> tuple[Table, RecordedFrames]:
    """Return a recording as arrays with touches, and what computes these."""
    frames = RecordedFrames(script, load_bundle(TINY))
    return table_of(script, None, None, frames), frames


def published(items: list[Any], name: str) -> list[Any]:
    """Return a field of each touch that was published, with NaN for None."""
    found = [getattr(touch, name) for item in items if isinstance(item, Frame) for touch in item.touches]
    return [np.nan if value is None else value for value in found]


def volts() -> np.ndarray:
    return np.array([np.frombuffer(step.frame.payload, "<i4", 104, 20) * VOLTS for step in scans(150)])


def test_npz_has_what_was_measured_and_published(with_maps: Path, items: list[Any], tmp_path: Path) -> None:
    script = Script(with_maps)
    write_npz(tmp_path / "a.npz", computed(script)[0], script)
    with np.load(tmp_path / "a.npz") as found:
        np.testing.assert_allclose(found["voltages_V"], volts(), rtol=1e-12)
        frames = [item for item in items if isinstance(item, Frame)]
        assert found["seq"].tolist() == [frame.sequence for frame in frames]
        assert found["map"].tobytes() == np.array([frame.map for frame in frames]).tobytes()
        index = found["cloud_index"]
        assert found["cloud_mm"][index[-1]].tobytes() == CLOUD.astype("<f4").tobytes()
        assert index.tolist() == sorted(index.tolist())
        assert str(found["serial"]) == "TEST-1"
        rows = [row for row, frame in enumerate(frames) for _ in frame.touches]
        assert found["touch_row"].tolist() == rows
        assert len(rows) > 20
        for name in ("id", "parent", "centre_mm", "peak", "place_mm", "normal", "confidence", "amplitude"):
            np.testing.assert_allclose(found[f"touch_{name}"], published(items, name), rtol=1e-5, atol=1e-5)
        assert np.isnan(found["touch_error_mm"]).all(), "the bundle was not taught"


def test_csv_has_a_line_a_touch_and_one_for_a_frame_without(with_maps: Path, items: list[Any], tmp_path: Path) -> None:
    assert cli.main(["convert", str(with_maps), "--bundle", str(TINY), "--out", str(tmp_path / "a.csv")]) == 0
    lines = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    frames = [item for item in items if isinstance(item, Frame)]
    assert [int(line["seq"]) for line in lines] == [
        frame.sequence for frame in frames for _ in range(max(1, len(frame.touches)))
    ]
    touches = [line for line in lines if line["id"]]
    assert [int(line["id"]) for line in touches] == published(items, "id")
    for name, ends in (("centre_mm", "xy"), ("place_mm", "xyz"), ("axes_mm", ("long", "short"))):
        found = [[float(line[f"{name}_{end}"]) for end in ends] for line in touches]
        np.testing.assert_allclose(found, published(items, name), rtol=1e-5, atol=1e-5)
    assert {line["error_mm_x"] for line in touches} == {"nan"}, "the bundle was not taught"


def test_a_camera_gets_the_newest_published_frame_and_never_an_old_one(with_maps: Path, tmp_path: Path) -> None:
    clock, out = tmp_path / "clock.txt", tmp_path / "a.npz"
    table, _ = computed(Script(with_maps))
    every_ns = table.columns["wall_ns"]
    table.columns["withheld"] = table.columns["withheld"].astype("<U20")
    table.columns["withheld"][70] = "damaged"
    times_ns = np.array(
        [every_ns[0] - 1, every_ns[0], every_ns[70] + 1, every_ns[-1] + 10**8, every_ns[-1] + 10**8 + 1]
    )
    found = resampled(table, times_ns)
    assert found.columns["seq"].tolist() == [100, 169, 249]
    assert found.columns["clock_ns"].tolist() == times_ns[1:4].tolist()
    assert found.touches is not None
    assert table.touches is not None
    assert found.touches.tobytes() == table.touches[table.touch_row == 69].tobytes() != b""
    assert set(found.touch_row.tolist()) == {1}

    words = ["convert", str(with_maps), "--bundle", str(TINY), "--out", str(out), "--rate", "30"]
    assert cli.main(words) == 0
    with np.load(out) as regular:
        at_ns, seq = regular["clock_ns"], regular["seq"].tolist()
    assert np.abs(np.diff(at_ns) - 1e9 / 30).max() <= 1
    assert seq == [100 + np.flatnonzero(every_ns <= one_ns)[-1] for one_ns in at_ns]
    clock.write_text("".join(f"{1e-9 * one_ns + 1e-6:.6f}\n" for one_ns in at_ns))
    assert cli.main([*words, "--clock", str(clock)]) == 0
    with np.load(out) as found_by_clock:
        assert found_by_clock["seq"].tolist() == seq


@pytest.mark.parametrize(
    ("text", "words", "says"),
    [
        ("", (), "is empty, expected one time a line"),
        ("time\n1.0\n", (), "line 1 of"),
        ("1.0\nnan\n", (), "line 2 of"),
        ("1.0\n1.0\n", (), "each after the one before"),
        ("1000\n1001\n", (), "name the clock of this recording"),
        ("1.0\n1.1\n1.2\n", ("--rate", "30"), "has 10 times a second, expected --rate 30"),
        (None, (), "no file"),
    ],
)
def test_a_clock_that_is_none_is_one_line(
    with_maps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str | None, words: tuple[str], says: str
) -> None:
    clock = tmp_path / "clock.txt"
    if text is not None:
        clock.write_text(text)
    out = str(tmp_path / "a.csv")
    assert cli.main(["convert", str(with_maps), "--out", out, "--clock", str(clock), *words]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert says in err


def twice() -> list[Step]:
    """Return frames of a device that starts anew amid them: it measures other voltages under the same numbers."""
    once = scans(60)
    again = []
    for index, step in enumerate(scans(60, seed=4)[7:]):
        payload = bytearray(step.frame.payload)
        struct.pack_into("<II", payload, 8, 100 + index, 1000 + 5000 * index)
        behind_ns = (60 + index) * PERIOD_NS
        again.append(Step(WireFrame(bytes(payload), 160 + index, behind_ns), 10**9 + behind_ns))
    return once + again


@pytest.mark.parametrize("every", [1, 3])
def test_each_frame_has_its_own_map_where_the_device_started_anew(tmp_path: Path, every: int) -> None:
    items = measured(steps=twice())
    recorded(tmp_path / "a.mcap", items, RecorderOptions(maps=True, every=every))
    maps = table_of(Script(tmp_path / "a.mcap")).maps
    frames = [item for item in items if isinstance(item, Frame)]
    assert maps is not None
    assert len(maps) == len(frames) == 113
    known = ~np.isnan(maps).any(axis=(1, 2))
    assert known.all() if every == 1 else 20 < known.sum() < 113
    assert [row for row, frame in enumerate(frames) if known[row] and (maps[row] != frame.map).any()] == []


def test_evaluate_measured_reads_npz_and_recordings_alike(with_maps: Path, tmp_path: Path) -> None:
    from eitskin_tools.evaluation.measured_file import load_measured

    script = Script(with_maps)
    write_npz(tmp_path / "a.npz", computed(script)[0], script)
    one, other = load_measured(tmp_path / "a.npz"), load_measured(with_maps)
    assert one.voltages_V.tobytes() == other.voltages_V.tobytes()
    assert one.clouds_mm.tobytes() == other.clouds_mm.tobytes()
    assert one.cloud_index.tolist() == other.cloud_index.tolist()
    assert set(other.kinds) == {"touched", "untouched"}


def test_touches_of_a_taught_bundle_are_those_that_were_published(tmp_path: Path) -> None:
    bundle, steps, rng = taught_bundle(tmp_path, TINY), [], np.random.default_rng(1)
    for index in range(60):
        push = response([(61.0, 40.0)])[0] * (30 <= index < 50)
        row = np.rint(counts() * np.exp(1e-3 * MIX @ (push + 0.1 * rng.normal(size=len(push))))).astype(np.int32)
        payload = WireScan(100 + index, 1000 + 5000 * index, row).pack()
        steps.append(Step(WireFrame(payload, 100 + index, index * PERIOD_NS), 10**9 + index * PERIOD_NS))
    items = measured(steps=steps, touches=True, bundle=bundle)
    recorded(tmp_path / "a.mcap", items)
    script = Script(tmp_path / "a.mcap")
    found = table_of(script, None, None, RecordedFrames(script, bundle)).touches
    assert found is not None
    assert len(found) == 20
    for name in ("centre_mm", "error_mm", "amplitude", "log_likelihood_ratio", "velocity_mm_s", "sign"):
        np.testing.assert_allclose(found[name], published(items, name), rtol=1e-5)
    assert reinfer(script, bundle).fields()["equal"] == 60
    late = [item for item in items if not isinstance(item, WireFrame) or item.seq is None or item.seq >= 120]
    recorded(tmp_path / "late.mcap", late)
    again = reinfer(Script(tmp_path / "late.mcap"), bundle).fields()
    assert not again["differing"]
    assert again["unknown_why"]["earlier"] == again["unknown"] > 0, "the first frames of a mean are missing"


@pytest.mark.slow  # its package comes with the slow tests
def test_parquet_has_the_same(with_maps: Path, items: list[Any], tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet", reason="extra: parquet")
    script = Script(with_maps)
    table, _ = computed(script)
    write_parquet(tmp_path / "a.parquet", table, script)
    found = pq.read_table(tmp_path / "a.parquet")
    assert found.num_rows == 150
    np.testing.assert_array_equal(np.array(found["voltages_V"].to_pylist()), table.voltages_V)
    assert found["seq"].to_pylist() == table.columns["seq"].tolist()
    clouds = {
        k: row for k, row in zip(found["cloud_index"].to_pylist(), found["cloud_mm"].to_pylist(), strict=True) if row
    }
    assert np.array([clouds[k] for k in sorted(clouds)], np.float32).tobytes() == table.clouds_mm.tobytes()
    assert found["cloud_mm"].null_count == 150 - len(table.clouds_mm)
    assert found.schema.metadata[b"serial"] == b"TEST-1"
    touches = found["touches"].to_pylist()
    assert [len(some) for some in touches] == [len(frame.touches) for frame in items if isinstance(frame, Frame)]
    assert [one["id"] for some in touches for one in some] == published(items, "id")
    places = [one["place_mm"] for some in touches for one in some]
    np.testing.assert_allclose(places, published(items, "place_mm"), rtol=1e-5, atol=1e-5)


@pytest.mark.slow  # the same
@pytest.mark.parametrize(("version", "storage"), [(8, "sqlite3"), (9, "mcap")])
def test_rosbag2_has_standard_messages_that_are_the_same(
    with_maps: Path, items: list[Any], tmp_path: Path, version: int, storage: str
) -> None:
    pytest.importorskip("rosbags", reason="extra: ros")
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    from eitskin_tools.recording.convert import write_rosbag

    script, store = Script(with_maps), get_typestore(Stores.ROS2_JAZZY)
    count = write_rosbag(tmp_path / "bag", script, frames=computed(script)[1], version=version)
    said = (tmp_path / "bag" / "metadata.yaml").read_text()
    assert f"version: {version}\n" in said
    assert f"storage_identifier: {storage}\n" in said
    rows, clouds, maps, points = [], [], [], []
    with Reader(tmp_path / "bag") as bag:
        assert bag.message_count == count
        for connection, _, raw in bag.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            if connection.topic == "/eitskin/voltages":
                rows.append(np.frombuffer(message.data.tobytes(), "<f8"))
            elif connection.topic == "/eitskin/surface":
                clouds.append(np.frombuffer(message.data.tobytes(), "<f4").reshape(-1, 4))
            elif connection.topic == "/eitskin/touches":
                kind = [(field.name, {6: "<u4", 7: "<f4"}[field.datatype]) for field in message.fields]
                points.append(np.frombuffer(message.data.tobytes(), kind))
            elif connection.topic == "/eitskin/map":
                maps.append((message.height, message.width, message.data.tobytes()))
    assert [len(some) for some in points] == [len(frame.touches) for frame in items if isinstance(frame, Frame)]
    touches = np.concatenate(points)
    assert touches["id"].tolist() == published(items, "id")
    places = np.stack([touches[name] for name in "xyz"], axis=-1)
    np.testing.assert_allclose(1e3 * places, published(items, "place_mm"), rtol=1e-5)
    np.testing.assert_allclose(1e6 * touches["area"], published(items, "area_mm2"), rtol=1e-5)
    assert np.isnan(touches["amplitude"]).all()
    np.testing.assert_allclose(np.array(rows), volts(), rtol=1e-12)
    np.testing.assert_allclose(clouds[-1][:, :3].T.reshape(3, 30, 45) * 1e3, CLOUD, rtol=1e-5, atol=1e-4)
    known = {frame.map.tobytes() for frame in items if isinstance(frame, Frame)}
    assert {data for _, _, data in maps} <= known
    assert {cloud[:, 3].tobytes() for cloud in clouds if np.isfinite(cloud).all()} == {data for _, _, data in maps}
    assert {(rows, columns) for rows, columns, _ in maps} == {(30, 45)}


def test_frames_are_held_against_the_reference_that_they_had(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from eitskin_tools.evaluation.measured_file import load_measured

    path, out = tmp_path / "a.mcap", tmp_path / "a.npz"
    items, later = measured(60, reference_at=140), stored(reference(1.01))
    state = next(item for item in items if isinstance(item, SkinState))
    told = replace(state, reference=later, reference_sha256=sha256(later).hexdigest())
    recorded(path, [*items, told])
    assert cli.main(["convert", str(path), "--out", str(out), "--json"]) == 0
    said, err = capsys.readouterr()
    assert json.loads(said)["later_reference"] == 20
    assert "20 frames, from " in err
    judged = load_measured(path)
    assert len(judged.voltages_V) == 40
    assert "20 frames with a later reference are left out" in judged.ending
    script = Script(path)
    begin_s = 1e-9 * (next(step.log_ns for step in script.steps() if step.frame.seq == 140) - script.first_ns)
    for way, stretch in (("--to", 1.0), ("--from", 1.01)):
        at_s = begin_s - 1e-6
        assert cli.main(["convert", str(path), "--out", str(out), way, f"{at_s:.9f}"]) == 0
        assert capsys.readouterr().err == ""
        with np.load(out) as found:
            np.testing.assert_allclose(found["reference_V"], reference(stretch).voltages_V)


PACKAGES = {"parquet": ("pyarrow", "extra: parquet"), "rosbag2": ("rosbags", "extra: ros")}


@pytest.mark.slow  # the same
@pytest.mark.parametrize(("kind", "name"), [("parquet", "part.parquet"), ("rosbag2", "part")])
def test_a_part_is_converted_by_the_command_line_and_a_folder_that_is_there_stays(
    with_maps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, name: str
) -> None:
    module, extra = PACKAGES[kind]
    pytest.importorskip(module, reason=extra)
    out, there = tmp_path / name, tmp_path / "there" / name
    script = Script(with_maps)
    steps = list(script.steps())
    begin_ns, end_ns = ((steps[at].log_ns + steps[at + 1].log_ns) // 2 for at in (39, 99))
    span = [f"{1e-9 * (at_ns - script.first_ns):.9f}" for at_ns in (begin_ns, end_ns)]
    words = ["convert", str(with_maps), "--bundle", str(TINY), "--from", span[0], "--to", span[1], "--json", "--out"]
    assert cli.main([*words, str(out)]) == 0
    said, err = capsys.readouterr()
    assert err == ""
    found = json.loads(said)
    assert (found["out"], found["format"]) == (str(out), kind)
    if kind == "parquet":
        assert (found["frames"], found["left_out"], found["maps"]) == (60, 0, True)
        import pyarrow.parquet as pq

        assert pq.read_table(out)["seq"].to_pylist() == [step.frame.seq for step in steps[40:100]]
    else:
        topics = Counter(one.topic for one in script.recording.entries() if begin_ns <= one.log_ns <= end_ns)
        maps = topics[MAP.topic]
        assert in_bag(out) == {  # and of surfaces and states the one that held at the beginning
            "touches": 60, "voltages": 60, "map": maps, "surface": 1 + topics[CLOUDS.topic] + maps,
            "state": 1 + topics[STATE.topic],
        }  # fmt: skip
        assert found["messages"] == sum(in_bag(out).values())
        assert 0 < maps < 60
    there.mkdir(parents=True)
    (there / "mine").write_bytes(b"precious")
    assert cli.main([*words, str(there)]) == 1
    said, err = capsys.readouterr()
    assert (said, err.count("\n")) == ("", 1)
    assert str(there) in err
    assert [(path.name, path.read_bytes()) for path in there.parent.rglob("*") if path != there] == [
        ("mine", b"precious")
    ]


def in_bag(folder: Path) -> Counter[str]:
    """Return how many messages each topic has."""
    from rosbags.rosbag2 import Reader

    with Reader(folder) as bag:
        return Counter(connection.topic.removeprefix("/eitskin/") for connection, _, _ in bag.messages())
