"""The device that was written from SPEC.md alone: it shares no code with the project, and agrees with its bytes."""

import ast
import json
import struct
from pathlib import Path
from typing import Any

import pytest

from . import codec, sheet
from .device import GRID_ID, NOISES, PATTERNS, PROTOCOL_ID, Device, Options, pattern, touched
from .store import HARDWARE, Configuration, Store, blob

ROOT = Path(__file__).parents[3]
GOLDEN: dict[str, Any] = json.loads((ROOT / "tests" / "golden" / "wire.json").read_text())
SPEC = (ROOT / "firmware_proto" / "SPEC.md").read_text(encoding="utf-8")
ATTACK = ROOT / "tests" / "attack"
OWN = [
    *sorted(Path(__file__).parent.glob("*.py")),
    ATTACK / "from_device" / "witness.py",
    *sorted((ATTACK / "zmtp").glob("*.py")),
    ATTACK / "subscribers" / "crowd.py",
    ATTACK / "pace.py",
]
ATTACKS_OWN = {"..zmtp.peer", "..pace"}
"""Modules of the attacks themselves that are among those that are looked at."""
MESSAGES = sorted(GOLDEN["messages"])


@pytest.fixture
def device() -> Device:
    return Device(Options())


def imported(path: Path) -> set[str]:
    """Return the names of all modules that a file imports, wherever in it; relative ones with their dots."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add("." * node.level + (node.module or ""))
    return names


@pytest.mark.parametrize("path", OWN, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_shares_no_code_with_the_project(path: Path) -> None:
    names = imported(path) - ATTACKS_OWN
    assert not {name for name in names if name.split(".")[0].startswith("eitskin") or name.startswith("..")}
    assert not names & {"cobs", "google_crc32c", "importlib", "runpy"}, "nor what the project uses for the same"


def test_the_test_of_imports_sees_them_all(tmp_path: Path) -> None:
    path = tmp_path / "x.py"
    path.write_text("def f():\n    import eitskin_proto.wire\n    from ..stream import ROOT\n")
    assert imported(path) == {"eitskin_proto.wire", "..stream"}


def test_the_check_is_crc_32c() -> None:
    for text, found in GOLDEN["crc32c"].items():
        assert f"{codec.crc32c(text.encode()):08x}" == found


@pytest.mark.parametrize("name", MESSAGES)
def test_every_golden_message_is_read_and_written_alike(name: str) -> None:
    payload, wire = (bytes.fromhex(GOLDEN["messages"][name][key]) for key in ("payload", "wire"))
    assert codec.packet(payload) == wire
    assert codec.unpacket(wire[:-1]) == payload
    fields = codec.unpack(payload)
    tail = fields[-1] if payload[0] in codec.TAILS else b""
    assert isinstance(tail, bytes)
    assert codec.pack(payload[0], *(fields[:-1] if payload[0] in codec.TAILS else fields), tail=tail) == payload
    if payload[0] == codec.FRAME:
        assert codec.frame_of(payload).payload() == payload


@pytest.mark.parametrize("name", sorted(GOLDEN["configurations"]))
def test_every_golden_configuration_is_one(name: str) -> None:
    found = Configuration.read(bytes.fromhex(GOLDEN["configurations"][name]))
    assert found.magic == codec.BLOB_MAGIC
    assert found.hardware_id == HARDWARE
    assert found.crc == codec.crc32c(bytes.fromhex(GOLDEN["configurations"][name])[:-4])


def test_the_ids_are_those_of_spec_and_golden_greeting() -> None:
    fields = codec.unpack(bytes.fromhex(GOLDEN["messages"]["hello"]["payload"]))
    assert fields[4:6] == (PROTOCOL_ID, GRID_ID)
    for named in (PROTOCOL_ID.hex(), GRID_ID.hex(), f"0x{HARDWARE:08x}"):
        assert named in SPEC, "a device cannot be written from SPEC.md without it"


@pytest.mark.parametrize("byte", [0, 1, 255])
def test_stuffing_of_every_length_comes_back_without_a_zero(byte: int) -> None:
    for size in range(1025):
        data = bytes((byte,)) * size
        stuffed = codec.stuff(data)
        assert 0 not in stuffed
        assert len(stuffed) <= size + 1 + size // 254
        assert codec.unstuff(stuffed) == data


def test_no_single_bit_of_a_packet_may_turn() -> None:
    wire = bytes.fromhex(GOLDEN["messages"]["hello"]["wire"])
    for bit in range(8 * (len(wire) - 1)):
        damaged = bytearray(wire)
        damaged[bit // 8] ^= 1 << bit % 8
        assert list(codec.Collector().feed(bytes(damaged))) == []


def test_a_collector_counts_what_is_damaged_and_goes_on_behind_it() -> None:
    collector = codec.Collector()
    whole = codec.packet(b"\x05\x01")
    sent = b"\x55" * 5000 + b"\0\0\0" + whole + whole[:-3] + b"\0" + codec.packet(bytes(1025)) + whole
    found = [payload for at in range(0, len(sent), 7) for payload in collector.feed(sent[at : at + 7])]
    assert (found, collector.damaged) == ([b"\x05\x01"] * 2, 3)


def test_the_table_is_that_of_the_text() -> None:
    rows = sheet.table()
    assert len(rows) == 104
    assert len(sheet.table(full=True)) == 208
    assert [sum(k == drive for k, _ in rows) for drive in range(16)] == [13, 13, *range(12, 0, -1), 0, 0]


def test_the_sheet_is_reciprocal_and_feels_a_touch() -> None:
    flat, touched = sheet.voltages(), sheet.voltages((75.0, 55.0))
    every = sheet.table(full=True)
    turned = [every.index((m, k)) for k, m in every]
    assert flat == pytest.approx(flat[turned], rel=1e-9)
    assert abs(touched / flat - 1).max() > 0.05


@pytest.mark.parametrize("first", [0, 2**32 - 400, 2**32 - 700])
def test_no_pattern_comes_again_within_64_scans_and_neither_over_the_wrap(first: int) -> None:
    numbers = [pattern((first + scan) % 2**32, 150, first) for scan in range(1000)]
    assert all(len(set(numbers[at : at + NOISES])) == NOISES for at in range(1000 - NOISES))
    assert set(numbers) == set(range(PATTERNS))
    assert not any(map(touched, numbers[:150]))


def test_what_cannot_be_read_is_answered_by_what_was_wrong(device: Device) -> None:
    for payload, code in ((b"\x77\x05", codec.UNKNOWN_TYPE), (b"\x02\x05", codec.BAD_LENGTH)):
        (said,) = device.receive(payload)
        assert codec.unpack(said) == (5, payload[0], code, len(payload))
    (said,) = device.receive(codec.pack(codec.SET_MODE, 9, 7))
    assert codec.unpack(said) == (9, codec.SET_MODE, codec.BAD_VALUE, 7)


def test_a_new_configuration_is_on_trial_until_it_is_confirmed_and_given_up_otherwise() -> None:
    for confirmed in (True, False):
        store = Store(blob())
        new = blob(name=b"new", averages=4)
        digest = Configuration.read(new).crc
        announced = (64, digest, HARDWARE, 1, 1, 0, b"new".ljust(16, b"\0"))
        assert store.answer(codec.BEGIN, (1, 7, *announced), False) == (codec.OK, 0)
        assert store.answer(codec.WRITE, (1, 8, 0, new[:4]), False)[0] == codec.BUSY
        for at in range(0, 64, 32):
            assert store.answer(codec.WRITE, (1, 7, at, new[at : at + 32]), False) == (codec.OK, at + 32)
        assert store.answer(codec.VERIFY, (1, 7), False) == (codec.OK, digest)
        assert store.answer(codec.COMMIT, (1, 7, digest), False) == (codec.OK, 2)
        store.boot()
        assert (store.trial, store.generation, store.running) == (True, 2, new)
        if confirmed:
            assert store.answer(codec.CONFIRM, (1, 2, digest), False) == (codec.OK, 2)
        store.boot()
        assert (store.generation, store.gave_up) == ((2, False) if confirmed else (1, True))


def test_a_frame_has_the_rows_of_its_drives(device: Device) -> None:
    device.receive(codec.pack(codec.START, 1, 0))
    device.receive(codec.pack(codec.SET_MODE, 1, 1))
    frame = device.scan()
    assert len(frame.counts) == 13 + 13 + 12 + 11
    assert frame.flags & 2
    payload = frame.payload()
    assert len(payload) == struct.calcsize(codec.LAYOUTS[codec.FRAME]) + 49 * 3 + 7
