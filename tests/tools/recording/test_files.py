"""The file itself: what is written comes back, cut anywhere, damaged anywhere, or where the disk is full."""

import random
import resource
from pathlib import Path

import pytest

from eitskin_tools.recording.layout import CLOUD, WIRE, RecordingError
from eitskin_tools.recording.reader import Recording
from eitskin_tools.recording.writer import FLUSH_S, Reserve, Series, path_of

HEAD = {"wall_minus_host_ns": "7"}


class Clock:
    """Seconds that pass when told."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def written(path: Path, chunks: int = 4, each: int = 20) -> list[bytes]:
    """Write chunks of messages, and return their contents."""
    clock, rng = Clock(), random.Random(1)
    writer = Series(path, HEAD, now_s=clock)
    contents = [rng.randbytes(200) for _ in range(chunks * each)]
    for number, content in enumerate(contents):
        if number % each == each - 1:
            clock.now += FLUSH_S
        writer.add(WIRE, content, number, number)
    writer.close()
    return contents


def test_what_is_written_comes_back_in_order(tmp_path: Path) -> None:
    contents = written(tmp_path / "a.mcap")
    found = Recording(tmp_path / "a.mcap")
    entries = list(found.entries())
    assert [entry.data for entry in entries] == contents
    assert [entry.sequence for entry in entries] == list(range(len(contents)))
    assert (found.cut, found.damaged) == (False, 0)
    assert HEAD.items() <= found.head.items()


def test_other_programs_read_it_by_its_summary(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    contents = written(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(contents)
        assert summary.statistics.chunk_count == 4
        assert [message.data for _, _, message in reader.iter_messages(topics=[WIRE.topic])] == contents
        assert {schema.name for schema in summary.schemas.values()} >= {"foxglove.Grid", "foxglove.PointCloud"}


def test_cut_anywhere_it_is_read_to_the_last_whole_chunk(tmp_path: Path) -> None:
    whole, cut = tmp_path / "a.mcap", tmp_path / "cut.mcap"
    contents = written(whole)
    data = whole.read_bytes()
    ends = [end for end in range(len(data)) if data[end : end + 1] == b"\x06"]  # a chunk's first byte, among others
    rng = random.Random(2)
    seen = set()
    for end in [*rng.sample(range(200, len(data)), 60), *rng.sample(ends, min(len(ends), 20))]:
        cut.write_bytes(data[:end])
        try:
            found = Recording(cut)
        except RecordingError as error:
            assert end < 400, error  # noqa: PT017 -- only before the head is whole
            continue
        got = [entry.data for entry in found.entries()]
        assert got == contents[: len(got)]
        assert len(got) % 20 == 0
        assert found.cut
        seen.add(len(got))
    assert seen >= {0, 20, 40, 60, 80}


def test_a_damaged_chunk_is_left_out_and_counted_and_the_others_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    contents = written(path)
    data = bytearray(path.read_bytes())
    for chunk, first in ((0, 0), (2, 40)):
        at = data.find(contents[first + 3][:64])
        if at < 0:
            pytest.skip("the contents were packed")  # random bytes are not
        data[at] ^= 0xFF
        damaged = tmp_path / f"damaged{chunk}.mcap"
        damaged.write_bytes(data)
        data[at] ^= 0xFF
        found = Recording(damaged)
        assert [entry.data for entry in found.entries()] == contents[:first] + contents[first + 20 :]
        assert (found.cut, found.damaged) == (False, 1)


def test_a_chunk_is_on_its_way_to_the_disk_after_a_quarter_of_a_second(tmp_path: Path) -> None:
    clock = Clock()
    writer = Series(tmp_path / "a.mcap", HEAD, now_s=clock)
    for number in range(100):
        writer.add(WIRE, b"x", number, number)
        clock.now += 0.02
        missing = number + 1 - sum(1 for _ in Recording(tmp_path / "a.mcap").entries()) if number % 10 == 9 else 0
        assert missing <= FLUSH_S / 0.02
    writer.close()


@pytest.mark.parametrize("bound", ["bytes", "age"])
def test_a_series_goes_on_in_files_that_each_say_what_holds(tmp_path: Path, bound: str) -> None:
    clock, first = Clock(), tmp_path / "a.mcap"
    bounds = {"most_bytes": 30_000} if bound == "bytes" else {"most_s": 1.0}
    series = Series(first, HEAD, now_s=clock, **bounds)
    series.attach("reference-1.json", "application/json", b"{}", 0)
    series.add(CLOUD, b"old", 0)
    series.add(CLOUD, b"cloud", 0)
    contents = [random.Random(number).randbytes(300) for number in range(400)]
    for number, content in enumerate(contents):
        clock.now += 0.01
        series.add(WIRE, content, number, number)
    series.close()
    assert len(series.files) >= 3
    assert series.files == [path_of(first, number + 1) for number in range(len(series.files))]
    found = []
    for path in series.files:
        one = Recording(path)
        entries = list(one.entries())
        assert [entry.data for entry in entries if entry.topic == CLOUD.topic][-1:] == [b"cloud"]
        assert one.attached == {"reference-1.json": b"{}"}
        assert not one.cut
        found += [entry.data for entry in entries if entry.topic == WIRE.topic]
    assert found == contents


def test_a_bound_on_the_size_of_files_is_named(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, before[1]))
    try:
        with pytest.raises(RecordingError, match="may not write files of 8 MB; allow larger ones with 'ulimit -f'"):
            Reserve(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
