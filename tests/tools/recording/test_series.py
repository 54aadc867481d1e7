"""Files of a series: each takes the next number that is free, and none that is there is lost."""

from pathlib import Path
from typing import Any

import pytest

from eitskin import SkinState
from eitskin_tools import cli
from eitskin_tools.recording.layout import MAP, WIRE
from eitskin_tools.recording.reader import Recording
from eitskin_tools.recording.script import Script
from eitskin_tools.recording.writer import Series, others, path_of

from .conftest import measured, recorded


def test_names_of_a_series_are_told_from_others(tmp_path: Path) -> None:
    for name in ("a.mcap", "a.0002.mcap", "a.12345.mcap", "a.02.mcap", "ab.0002.mcap", "a.0002.mcap.gz", "b.0003.mcap"):
        (tmp_path / name).touch()
    assert others(tmp_path / "a.mcap") == [tmp_path / "a.0002.mcap", tmp_path / "a.12345.mcap"]


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


def test_a_runtime_that_starts_anew_passes_over_a_file_as_well(tmp_path: Path, items: list[Any]) -> None:
    path_of(tmp_path / "a.mcap", 2).write_bytes(b"precious")
    recorder = recorded(tmp_path / "a.mcap", [*items, *measured(60)])
    assert recorder.series is not None
    assert recorder.series.files == [tmp_path / "a.mcap", tmp_path / "a.0003.mcap"]
    assert Script(tmp_path / "a.0003.mcap").frames == 60


@pytest.mark.parametrize("quiet", [False, True])
def test_the_command_says_at_its_start_what_is_there(
    tmp_path: Path,
    items: list[Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    *,
    quiet: bool,
) -> None:
    """The stream comes from this process, and is over when all of it was taken."""
    from eitskin_tools.commands import record
    from eitskin_tools.recording import recorder as intake

    class Here:
        silent, dropped = None, 0

        def __init__(self, sources: Any) -> None:
            pass

        def close(self) -> None:
            pass

    def go_on(arguments: Any, recorder: Any, taken: Any, stopped: Any) -> bool:
        assert ("r.0002.mcap" in capsys.readouterr().err) is not quiet
        for item in sorted(items, key=lambda one: not isinstance(one, SkinState)):
            recorder.take(item)
            recorder.series.sync()
        return False

    monkeypatch.setattr(intake, "Intake", Here)
    monkeypatch.setattr(record, "_go_on", go_on)
    path_of(tmp_path / "r.mcap", 2).write_bytes(b"precious")
    words = ["record", "--out", str(tmp_path / "r.mcap"), "--rotate-mb", "0.05", *(["--quiet"] if quiet else [])]
    assert cli.main(words) == 0
    made = [tmp_path / "r.mcap", *(path for path in others(tmp_path / "r.mcap") if "0002" not in path.name)]
    assert len(made) > 2
    assert sum(Script(path).frames for path in made) == 150
    assert path_of(tmp_path / "r.mcap", 2).read_bytes() == b"precious"
