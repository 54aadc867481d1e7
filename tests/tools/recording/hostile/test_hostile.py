"""Recordings that say what no recorder writes: each is read, or refused in a line, and soon."""

import json
import random
import time
from contextlib import suppress

import pytest

from eitskin.model.bundle import load_bundle
from eitskin_proto.errors import SkinError
from eitskin_proto.files.digest import sha256_of, sha256_of_values
from eitskin_tools.cli import main
from eitskin_tools.recording.convert import table_of
from eitskin_tools.recording.frames import number
from eitskin_tools.recording.layout import FRAME, WIRE, RecordingError
from eitskin_tools.recording.plot import course_of
from eitskin_tools.recording.reader import MOST_RECORDS, Recording
from eitskin_tools.recording.reinfer import reinfer
from eitskin_tools.recording.replay import Player, ReplayOptions
from eitskin_tools.recording.script import MOST_FRAMES_S, Script
from eitskin_tools.view.film import MAX_FRAMES, Film

from ..conftest import TINY, Taker, rewritten
from .files import KINDS, LARGEST, Honest, chunk, chunks, message, record
from .files import WIRE as WIRE_NUMBER

HUGE = 10**400
CPU_S = 10.0
"""Of reading one file in several ways; it takes half a second."""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_file_that_asks_for_endless_work_is_read_or_refused_soon(file, kind, seed):
    path = file.with_name(f"{kind}.mcap")
    path.write_bytes(KINDS[kind](Honest(file), random.Random(seed)))
    began_s = time.process_time()
    with suppress(SkinError):
        film = Film(path, TINY)
        for part in {0, film.parts // 2, film.parts - 1}:
            film.part(part)
    for read in (reinfer, course_of, lambda script, _: table_of(script)):
        with suppress(SkinError):
            read(Script(path), load_bundle(TINY))
    assert time.process_time() - began_s < CPU_S


@pytest.mark.parametrize(
    "inner",
    [record(3, b"") * 1001, message(WIRE_NUMBER, 0, b"") * (MOST_RECORDS + 1), record(12, b"x"), bytes(LARGEST),
     random.Random(0).randbytes(9 << 20)],
    ids=["schemas", "messages", "metadata", "packed", "large"],
)  # fmt: skip
def test_a_chunk_that_no_recorder_writes_is_left_out(file, inner):
    honest = Honest(file)
    file.write_bytes(honest.file(honest.body, chunk(inner)))
    found = Recording(file)
    assert len(list(found.entries())) == len(honest.rows)
    assert found.damaged == 1


def test_frames_faster_than_those_of_any_device_are_refused(file):
    honest, rng = Honest(file), random.Random(0)
    frames = honest.frames(MOST_FRAMES_S + 1, 1, read_ns=lambda _: rng.getrandbits(60))
    file.write_bytes(honest.file(honest.body, *chunks(frames)))
    with pytest.raises(RecordingError, match=f"over {MOST_FRAMES_S} frames in a second"):
        table_of(Script(file))
    with pytest.raises(RecordingError, match=f"over {MAX_FRAMES} frames in a second"):
        Film(file, TINY).part(0)


@pytest.mark.parametrize("words", [("convert", "--out", "c.npz"), ("reinfer", "--quiet", "--out", "m.npz")])
def test_times_after_every_era_are_left_out(file, words, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = rewritten(file, lambda topic, data, ns: (data, (1 << 63) + ns if topic == WIRE.topic else ns))
    assert main([words[0], str(path), *words[1:], "--bundle", str(TINY)]) == 1
    assert "holds no frame from the device" in capsys.readouterr().err


@pytest.mark.slow  # rosbags is there
def test_a_bag_of_times_that_ros_cannot_hold_is_refused(file, tmp_path, capsys):
    pytest.importorskip("rosbags", reason="extra: ros")
    path = rewritten(file, lambda _, data, ns: (data, (1 << 62) + ns % 10**12))
    assert (
        main(["convert", str(path), "--out", str(tmp_path / "bag"), "--format", "rosbag2", "--bundle", str(TINY)]) == 1
    )
    assert "after 2038, which ROS has no time for" in capsys.readouterr().err


@pytest.mark.parametrize("fields", [{"drift": HUGE, "drift_sd": float("inf")}, {"number": float("inf")}, {"events": 7}])
def test_notes_that_make_no_sense_say_nothing(file, fields):
    path = rewritten(
        file, lambda at, data, ns: (json.dumps(json.loads(data) | fields).encode() if at == FRAME.topic else data, ns)
    )
    with Player(Script(path), ReplayOptions(paced=False), bundle=TINY) as player:
        assert sum(1 for _ in player.skin.publish(Taker())) > 100
    assert main(["reinfer", str(path), "--bundle", str(TINY), "--quiet"]) in (0, 1)
    assert Film(path, TINY).part(0)


def test_numbers_that_a_page_cannot_hold_are_none():
    assert [number(value) for value in (HUGE, -HUGE, float("nan"), float("inf"), "1", None)] == [None] * 6
    assert (number(3), number(-0.5)) == (3.0, -0.5)


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
