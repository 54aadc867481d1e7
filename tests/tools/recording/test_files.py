"""The file itself: what is written comes back, cut anywhere, damaged anywhere, or where the disk is full."""

import errno
import os
import random
import resource
from pathlib import Path

import pytest

from eitskin_tools.recording import writer as sinks
from eitskin_tools.recording.layout import CLOUD, WIRE, RecordingError
from eitskin_tools.recording.reader import Recording
from eitskin_tools.recording.writer import FLUSH_S, RecordingWriter, Series, path_of

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
    assert found.wall_minus_host_ns == 7


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


def test_bytes_changed_anywhere_never_give_a_message_that_was_not_written(tmp_path: Path) -> None:
    path, other = tmp_path / "a.mcap", tmp_path / "b.mcap"
    contents = set(written(path))
    data = path.read_bytes()
    rng = random.Random(5)
    for _ in range(60):
        changed = bytearray(data)
        for _ in range(3):
            changed[rng.randrange(len(changed))] = rng.randrange(256)
        other.write_bytes(changed)
        try:
            found = Recording(other)
        except RecordingError:
            continue
        assert {entry.data for entry in found.entries()} <= contents


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


class SmallDisk:
    """Room for so many bytes, of which the reserve takes its part while it is held."""

    def __init__(self, room: int, reserve: int) -> None:
        self.room, self.reserve, self.used = room, reserve, 0
        self.write_really = os.write
        self.sink: sinks.Sink | None = None

    def write(self, handle: int, data: memoryview) -> int:
        held = 0 if self.sink is None or self.sink.full else self.reserve
        left = self.room - held - self.used
        if left <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = self.write_really(handle, bytes(data)[:left])  # in part, as a disk does
        self.used += written
        return written


def test_where_the_disk_is_full_the_file_is_ended_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reserve = 64 << 10
    disk = SmallDisk(150_000, reserve)
    clock, path = Clock(), tmp_path / "a.mcap"
    held = sinks.Reserve(tmp_path, reserve)
    writer = RecordingWriter(path, HEAD, held, clock)
    disk.sink, disk.used = writer._sink, writer.size
    monkeypatch.setattr(sinks.os, "write", disk.write)
    contents = []
    while not writer.full:
        contents.append(random.Random(len(contents)).randbytes(300))
        clock.now += 0.02
        writer.add(WIRE, contents[-1], len(contents), len(contents))
    writer.close()
    held.release()
    assert disk.used <= disk.room
    found = Recording(path)
    assert [entry.data for entry in found.entries()] == contents
    assert not found.cut
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(contents)


def test_a_bound_on_the_size_of_files_is_named(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, before[1]))
    try:
        with pytest.raises(RecordingError, match="may not write files of 8 MB; allow larger ones with 'ulimit -f'"):
            sinks.Reserve(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("claimed", [1 << 40, (1 << 63) - 1, (1 << 64) - 1, 4000, 300])
def test_a_length_within_a_chunk_that_is_beyond_it_ends_the_reading(tmp_path: Path, claimed: int) -> None:
    """Lengths stand in records as well as before them; the first ones are beyond any memory."""
    path = tmp_path / "a.mcap"
    contents = written(path)
    data = bytearray(path.read_bytes())
    at, second = 8, 0
    while second < 2:
        length = int.from_bytes(data[at + 1 : at + 9], "little")
        second += data[at] == 6
        at += 9 + length
    at -= length  # of the second chunk's content
    name_at = at + 28
    length_at = name_at + 4 + int.from_bytes(data[name_at : name_at + 4], "little")
    data[length_at : length_at + 8] = claimed.to_bytes(8, "little")
    path.write_bytes(data)
    found = Recording(path)
    got = [entry.data for entry in found.entries()]
    assert got[:20] == contents[:20]
    assert set(got) <= set(contents)
    assert found.cut or found.damaged or got == contents
