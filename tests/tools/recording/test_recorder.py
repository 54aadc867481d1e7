"""From what streams and frames say to a file, and from the file to what happened, frame by frame."""

import base64
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.second_skin import SECOND, rolled

from eitskin import CloudInUse, Frame, SkinState, WireFrame
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.recording import layout, pictures
from eitskin_tools.recording.codec import digest_of, pack_map, unpack_json, unpack_map
from eitskin_tools.recording.layout import CLOUD, CONDITIONS, FRAME, MAP, STATE, WIRE, RecordingError
from eitskin_tools.recording.reader import Recording
from eitskin_tools.recording.recorder import RecorderOptions
from eitskin_tools.recording.script import Script

from .conftest import CLOUD as GIVEN
from .conftest import RATIO, VOLTS, counts, measured, recorded


def of(items: list[Any], kind: type) -> list[Any]:
    return [item for item in items if isinstance(item, kind)]


def test_every_frame_of_the_wire_comes_back_as_it_came(file: Path, items: list[Any]) -> None:
    steps = list(Script(file).steps())
    frames = of(items, WireFrame)
    assert [step.frame.body() for step in steps] == [frame.body() for frame in frames]
    offset = int(Recording(file).head["wall_minus_host_ns"])
    assert [step.log_ns - offset for step in steps] == [frame.read_ns for frame in frames]


def test_each_frame_meets_the_cloud_and_the_reference_that_it_met(file: Path, items: list[Any]) -> None:
    steps = list(Script(file).steps())
    first = next(step for step in steps if step.reference is not None)
    assert first.reference == next(item.reference for item in items if isinstance(item, SkinState))
    clouds = {step.frame.seq: step.cloud for step in steps if step.cloud is not None}
    assert [cloud.why for cloud in clouds.values()] == ["start", "given"]
    given = next(item for item in of(items, CloudInUse) if item.why == "given")
    assert given.seq in clouds
    assert clouds[given.seq].cloud.tobytes() == GIVEN.astype("<f4").tobytes()
    assert clouds[given.seq].predicted.tobytes() == (RATIO * (counts() * VOLTS)).tobytes()


def test_a_part_begins_with_everything_that_held_then(file: Path) -> None:
    script = Script(file)
    steps = script.steps()
    first = next(steps)
    while not ((step := next(steps)).cloud is not None and step.cloud.why == "given"):
        pass  # how long it took to be taken in is the machine's affair
    after = next(script.steps(1e-9 * (next(steps).log_ns - first.log_ns)))
    assert after.cloud is not None
    assert after.cloud.why == "given"
    assert after.reference is not None
    assert after.frame.seq > step.frame.seq
    some = list(script.steps(0.0, script.seconds / 2))
    assert 0 < len(some) < script.frames
    with pytest.raises(RecordingError, match="it lasts"):
        next(script.steps(1000.0))


def test_of_each_published_frame_a_note_says_what_it_was_and_a_digest_which_map(file: Path, items: list[Any]) -> None:
    notes = [unpack_json(entry.data) for entry in Recording(file).entries({FRAME.topic})]
    frames = of(items, Frame)
    assert [(note["seq"], note["touched"], note["solver"]) for note in notes] == [
        (frame.sequence, frame.touched, frame.solver) for frame in frames
    ]
    assert [note["digest"] for note in notes] == [digest_of(frame.map) for frame in frames]
    maps = {frame.map_sequence: frame.map.tobytes() for frame in frames}
    assert len({note["digest"] for note in notes}) == len(set(maps.values())) > 2


@pytest.mark.parametrize("every", [1, 4])
def test_maps_are_kept_where_they_are_asked_for(tmp_path: Path, items: list[Any], every: int) -> None:
    recorded(tmp_path / "a.mcap", items, RecorderOptions(maps=True, every=every))
    found = dict(unpack_map(entry.data) for entry in Recording(tmp_path / "a.mcap").entries({MAP.topic}))
    frames = {frame.map_sequence: frame.map for frame in of(items, Frame)}
    assert list(found) == list(frames)[::every]
    for sequence, values in found.items():
        assert values.tobytes() == frames[sequence].tobytes()


def test_what_comes_before_the_skin_says_what_it_is_waits_and_is_not_lost(tmp_path: Path, items: list[Any]) -> None:
    states, rest = of(items, SkinState), [item for item in items if not isinstance(item, SkinState)]
    recorder = recorded(tmp_path / "a.mcap", [*rest[:50], states[0], *rest[50:]])
    assert recorder.frames == Script(tmp_path / "a.mcap").frames == len(of(items, WireFrame))


def test_a_runtime_that_starts_anew_gets_a_file_of_its_own(tmp_path: Path, items: list[Any]) -> None:
    recorder = recorded(tmp_path / "a.mcap", [*items, *measured(60)])
    assert recorder.series is not None
    first, second = (Script(path) for path in recorder.series.files)
    assert (first.frames, second.frames) == (len(of(items, WireFrame)), 60)
    assert first.head_text("run") != second.head_text("run")
    assert all(step.known for step in second.steps())
    assert next(second.steps()).reference is not None


def test_all_has_the_clock_of_the_frames_though_the_wall_clock_jumps_and_the_recorder_has_another(
    tmp_path: Path, items: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    hour_ns, wall_ns, first = 3_600_000_000_000, time.time_ns, of(items, SkinState)[0]
    later = [
        replace(item, utc_ns=item.utc_ns + hour_ns)
        if isinstance(item, CloudInUse | SkinState) and item.utc_ns and item is not first
        else item
        for item in items
    ]
    monkeypatch.setattr(time, "time_ns", lambda: wall_ns() - 2 * hour_ns)
    recorded(tmp_path / "a.mcap", later)
    entries = list(Recording(tmp_path / "a.mcap").entries())
    times = [entry.log_ns for entry in entries]
    assert {CLOUD.topic, CONDITIONS.topic, STATE.topic, WIRE.topic} <= {entry.topic for entry in entries}
    assert max(times) - min(times) < hour_ns // 60


def test_the_map_as_foxglove_grid_is_the_map_to_a_1024th() -> None:
    values = np.random.default_rng(0).random((30, 45), dtype=np.float32)
    found = json.loads(pictures.grid(values, (10 / 3, 10 / 3), 1_700_000_000_000_000_005))
    shown = np.frombuffer(base64.b64decode(found["data"]), "<f4").reshape(-1, found["row_stride"] // 4)
    assert shown.shape == (30, found["column_count"])
    assert np.abs(shown - values).max() <= 0.5 / 1024
    assert found["timestamp"] == {"sec": 1_700_000_000, "nsec": 5}
    assert found["cell_size"]["x"] * found["column_count"] == pytest.approx(0.15)
    assert set(found) == set(json.loads(layout.GRID.schema)["properties"])


def test_the_surface_as_foxglove_points_is_the_cloud_in_metres_with_the_map() -> None:
    values = np.random.default_rng(0).random((30, 45), dtype=np.float32)
    cloud = (PAPER.grid.flat_cloud_mm() + 5.0).astype(np.float32)
    found = json.loads(pictures.surface(values, cloud, 5))
    raw = base64.b64decode(found["data"])
    kind = np.dtype(
        {"names": [one["name"] for one in found["fields"]], "formats": ["<f4"] * 4,
         "offsets": [one["offset"] for one in found["fields"]], "itemsize": found["point_stride"]}
    )  # fmt: skip
    points = np.frombuffer(raw, kind)
    assert len(points) == 1350
    for axis, name in enumerate("xyz"):
        np.testing.assert_allclose(points[name], cloud[axis].reshape(-1) * 1e-3, rtol=1e-6, atol=1e-9)
    assert np.abs(points["touched"] - values.reshape(-1)).max() <= 0.5 / 1024
    assert found["point_stride"] % 3 == 0
    assert set(found) == set(json.loads(layout.SURFACE.schema)["properties"])


@pytest.mark.parametrize("bent", [False, True])
def test_the_grid_of_another_sheet_has_that_sheets_pixels(tmp_path: Path, items: list[Any], bent: bool) -> None:
    rows, columns = SECOND.grid.shape
    cloud = (rolled(SECOND, 90.0) if bent else SECOND.grid.flat_cloud_mm()).astype("f4")

    def of_second(item: Any) -> Any:
        if isinstance(item, SkinState):
            return replace(item, grid_id=SECOND.grid_id)
        if isinstance(item, CloudInUse):
            return replace(item, cloud=cloud, why="given" if bent else "start")
        return replace(item, map=np.zeros((rows, columns), np.float32)) if isinstance(item, Frame) else item

    recorded(tmp_path / "a.mcap", [of_second(item) for item in items])
    found = [json.loads(one.data) for one in Recording(tmp_path / "a.mcap").entries({layout.GRID.topic})]
    assert found
    width, height = SECOND.grid.pixel_mm
    for one in found:
        assert one["cell_size"]["x"] == pytest.approx(1e-3 * width, rel=1e-3)
        assert one["cell_size"]["y"] == pytest.approx(1e-3 * height, rel=1e-3)
        assert one["column_count"] == columns


@pytest.mark.parametrize("data", [b"", b"\x00", pack_map(1, np.zeros((2, 2), np.float32))[:-1], b"\x81\xa3seq\x01"])
def test_a_map_that_makes_no_sense_is_refused(data: bytes) -> None:
    with pytest.raises(RecordingError):
        unpack_map(data)


def test_messages_that_make_no_sense_are_counted_and_the_rest_is_read(tmp_path: Path, items: list[Any]) -> None:
    from eitskin_tools.recording.writer import Series

    class Broken(Series):
        def add(self, channel: Any, data: bytes, log_ns: int, sequence: int = 0) -> None:
            super().add(channel, data, log_ns, sequence)
            if channel in (CLOUD, WIRE) and sequence == 1:
                super().add(channel, b"\xc1", log_ns, sequence)

    from eitskin_tools.recording.recorder import Recorder

    recorder = Recorder(lambda head: Broken(tmp_path / "a.mcap", head), RecorderOptions())
    for item in items:
        recorder.record(item)
    recorder.close()
    script = Script(tmp_path / "a.mcap")
    assert len(list(script.steps())) == len(of(items, WireFrame))
    assert script.ending == "; 2 messages make no sense"
