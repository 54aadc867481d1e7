"""Files of a series: each takes the next number that is free, and none that is there is lost."""

from pathlib import Path

from eitskin_tools.recording.layout import MAP, WIRE
from eitskin_tools.recording.reader import Recording
from eitskin_tools.recording.writer import Series, path_of


def test_what_is_there_is_passed_over_and_stays(tmp_path: Path) -> None:
    first = tmp_path / "r.mcap"
    path_of(first, 2).write_bytes(b"precious")
    path_of(first, 3).mkdir()
    path_of(first, 5).symlink_to(tmp_path / "nowhere")
    series = Series(first, {}, most_bytes=1)
    for number in range(3):
        series.add(WIRE, bytes([number]), number, number)
        series.sync()
    series.close()
    assert series.files == [first, *(path_of(first, number) for number in (4, 6))]
    found = [entry.data for path in series.files for entry in Recording(path).entries({WIRE.topic})]
    assert found == [b"\0", b"\1", b"\2"]
    assert path_of(first, 2).read_bytes() == b"precious"
    assert not (tmp_path / "nowhere").exists()


def test_every_file_begins_with_a_frame_of_the_wire(tmp_path: Path) -> None:
    series = Series(tmp_path / "r.mcap", {}, most_bytes=1)
    for number in range(3):
        series.add(WIRE, bytes([number]), number, number)
        series.add(MAP, b"map", number, number)
        series.sync()
    series.close()
    found = [[entry.topic for entry in Recording(path).entries()] for path in series.files]
    assert found == [[WIRE.topic, MAP.topic]] * 3
