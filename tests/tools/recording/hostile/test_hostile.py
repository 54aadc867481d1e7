"""Recordings that say what no recorder writes: each is read, or refused in a line, and soon."""

import json
import struct
import zlib

import pytest
import zstandard
from mcap.records import Chunk

from eitskin_proto.files.digest import sha256_of, sha256_of_values
from eitskin_tools.cli import main
from eitskin_tools.recording.frames import number
from eitskin_tools.recording.layout import FRAME, STATE, WIRE, RecordingError
from eitskin_tools.recording.reader import Recording, unpacked
from eitskin_tools.recording.replay import Player, ReplayOptions
from eitskin_tools.recording.script import Script, SeekableRecording

from ..conftest import TINY, Taker, rewritten

HUGE = 10**400


def with_fields(file, topic, **fields):
    """Write it anew with other fields in every JSON message of a channel."""
    return rewritten(
        file, lambda at, data, ns: (json.dumps(json.loads(data) | fields).encode() if at == topic else data, ns)
    )


@pytest.mark.parametrize("words", [("convert", "--out", "c.npz"), ("reinfer", "--quiet", "--out", "m.npz")])
def test_times_after_every_era_are_left_out(file, words, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = rewritten(file, lambda topic, data, ns: (data, (1 << 63) + ns if topic == WIRE.topic else ns))
    more = ["--bundle", str(TINY)] if words[0] == "reinfer" else []
    assert main([words[0], str(path), *words[1:], *more]) == 1
    assert "holds no frame from the device" in capsys.readouterr().err


@pytest.mark.parametrize(
    "fields", [{"events": 7}, {"status": None}, {"status": [1]}, {"status": {"drift": {"percent": HUGE}}}]
)
def test_states_that_make_no_sense_say_nothing(file, fields):
    path = with_fields(file, STATE.topic, **fields)
    with Player(Script(path), ReplayOptions(paced=False), bundle=TINY) as player:
        assert sum(1 for _ in player.skin.publish(Taker())) > 100


@pytest.mark.parametrize("fields", [{"drift": HUGE, "drift_sd": float("inf")}, {"number": float("inf")}])
def test_notes_that_make_no_sense_say_nothing(file, fields):
    path = with_fields(file, FRAME.topic, **fields)
    with Player(Script(path), ReplayOptions(paced=False), bundle=TINY) as player:
        assert sum(1 for _ in player.skin.publish(Taker())) > 100
    assert main(["reinfer", str(path), "--bundle", str(TINY), "--quiet"]) in (0, 1)
    assert SeekableRecording(path).span(0.0, 1.0).steps


def test_numbers_that_a_page_cannot_hold_are_none():
    assert [number(value) for value in (HUGE, -HUGE, float("nan"), float("inf"), "1", None)] == [None] * 6
    assert (number(3), number(-0.5)) == (3.0, -0.5)


def test_a_reference_that_is_lacking_is_not_looked_for_in_every_second_of_a_thousand_years(file):
    last = [one.log_ns for one in Recording(file).entries({WIRE.topic})][-1]
    path = rewritten(file, lambda _, data, ns: (data, (1 << 62) if ns == last else ns), attached=False)
    moments = SeekableRecording(path)
    assert moments.seconds > 1e9
    with pytest.raises(RecordingError, match="has no reference"):
        moments.reference()


@pytest.mark.parametrize("unit", [bytes(9), b"\x0c" + struct.pack("<Q", 1) + b"x"])
def test_a_chunk_of_millions_of_nothings_is_damaged_at_once(unit):
    inner = unit * 100_000
    chunk = Chunk("zstd", zstandard.compress(inner), 1, 0, zlib.crc32(inner), len(inner))
    with pytest.raises(ValueError, match="a record of kind"):
        unpacked(chunk)


def test_a_chunk_that_says_that_it_is_larger_than_any_is_not_unpacked():
    chunk = Chunk("zstd", zstandard.compress(bytes(9 << 20)), 1, 0, 0, 9 << 20)
    with pytest.raises(ValueError, match="a chunk of"):
        unpacked(chunk)


def reinfers_or_says_why(path, capsys):
    """Reinfer a recording: its maps, or one printable line and nothing else."""
    status = main(["reinfer", str(path), "--bundle", str(TINY), "--quiet"])
    out, err = capsys.readouterr()
    if status == 0:
        return ""
    assert (status, out, err.count("\n")) == (1, "", 1), err
    assert err.startswith("eitskin reinfer: ")
    assert err.rstrip("\n").isprintable()
    return err


@pytest.mark.parametrize("key", ["hello", "protocol_id", "grid_id", "skin", "wall_minus_host_ns", "version"])
@pytest.mark.parametrize("value", ["", "80ff", "9" * 400, "\x1b[2J"])
def test_an_altered_head_is_read_or_refused_in_a_line(file, key, value, capsys):
    path = rewritten(file, lambda _, data, ns: (data, ns), head={key: value})
    said = reinfers_or_says_why(path, capsys)
    assert said or key not in ("hello", "protocol_id", "version")


@pytest.mark.parametrize(
    "fields",
    [{"voltages_V": [float("nan")] * 104}, {"voltages_V": [1e300] * 104}, {"voltages_V": []}, {"voltages_V": "x"},
     {"spread_V": None}, {"frames": -1}, {"version": 99}, {"protocol_id": "\x1b[2J"}, {"serial_number": "a\nb"},
     {"sha256": "0" * 64}],
    ids=str,
)  # fmt: skip
def test_an_altered_reference_that_the_frames_name_is_read_or_refused_in_a_line(file, fields, capsys):
    ((name, whole),) = Recording(file).attached.items()
    held = json.loads(whole) | fields
    if "sha256" not in fields:
        del held["sha256"]
        held["sha256"] = sha256_of_values(held)
    altered = json.dumps(held).encode()
    old, new = (sha256_of(one).encode() for one in (whole, altered))
    path = rewritten(file, lambda _, data, ns: (data.replace(old, new), ns), attached={name: altered})
    said = reinfers_or_says_why(path, capsys)
    assert said or "serial_number" in fields
