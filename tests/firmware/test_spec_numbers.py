"""Numbers and words that SPEC.md states by hand, against those that the C core and the Python side have."""

import re

import pytest
from tests.emulator.firmware import FOLDER
from tests.faults.requests import specification

from eitskin_proto.sensor import ids
from eitskin_proto.wire import codes, config, hardware, messages
from eitskin_tools.virtual_skin import device, store

SPEC = (FOLDER / "SPEC.md").read_text(encoding="utf-8")
FLAT = " ".join(SPEC.split())


def table(after):
    """Return the rows of the first table after some text, without its head, as lists of cells."""
    found = re.search(r"\n((?:\|.*\n)+)", SPEC.split(after, 1)[1]).group(1)
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in found.splitlines()[2:]]


def define(name, header):
    """Return the number of a C macro."""
    text = (FOLDER / "core" / header).read_text(encoding="utf-8")
    return int(re.search(rf"^#define {name} (0x[0-9a-f]+|\d+)u", text, re.MULTILINE).group(1), 0)


def test_a_slot_in_storage_is_laid_out_as_the_table_says():
    rows = {row[2]: (int(row[0]), int(row[1])) for row in table("### Storage")}
    assert rows.pop("blob") == (0, config.BLOB_BYTES)
    for name, (at, width) in rows.items():
        assert (at, width) == (define(f"EIT_SLOT_{name.upper()}", "eit_store.h"), 4), name
    assert set(rows) == {"generation", "commit", "attempt", "confirm", "revoked"}
    assert f"Two slots of {define('EIT_SLOT_BYTES', 'eit_store.h')} bytes" in FLAT
    assert f"two flash slots of {define('EIT_SLOT_BYTES', 'eit_store.h')} bytes" in (
        FOLDER.parent / "docs" / "hardware.md"
    ).read_text(encoding="utf-8")


def test_the_two_magics_are_the_specifications():
    message, blob = re.search(r"`magic` four letters, (\w+) in messages and (\w+) in a configuration", FLAT).groups()
    assert (message.encode(), blob.encode()) == (codes.MAGIC, config.BLOB_MAGIC)
    header = (FOLDER / "core" / "eit_wire.h").read_text(encoding="utf-8")
    for name, word in (("EIT_MAGIC", message), ("EIT_CONFIG_MAGIC_BYTES", blob)):
        assert f"#define {name} {{{', '.join(f'0x{ord(letter):02x}' for letter in word)}}}" in header


def test_what_a_blob_always_has_is_what_blobs_are_refused_for():
    always = {row[2]: row[4] for row in table("<!-- generated: configuration -->") if row[4]}
    assert always == {"magic": "EITC", "format": str(config.FORMAT), "size": str(config.BLOB_BYTES)}
    assert f"bytes {config.SKIN_AT} to {config.SKIN_AT + 7}, then is that skin's `grid_id` or digest" in FLAT
    assert f"a name has at most {config.SHORT_NAME} characters" in FLAT


def test_limits_and_ids_are_the_devices():
    found = dict(table("<!-- generated: hardware -->"))
    can = hardware.EITSKIN_16
    assert int(found["hardware_id"], 0) == can.id == define("EIT_HARDWARE_ID", "eit_wire.h")
    assert found["frequency_Hz"] == f"{can.min_frequency_hz} to {can.max_frequency_hz}"
    assert dict(table("<!-- generated: ids -->"))["protocol_id"] == ids.PROTOCOL_ID


@pytest.mark.parametrize(
    ("sentence", "us"), [(r"until (\d+) s pass without a request that carries it", "EIT_LOCK_US"),
                         (r"waits (\d+) s on trial without", "EIT_TRIAL_US")]
)  # fmt: skip
def test_times_are_the_same_everywhere(sentence, us):
    seconds = int(re.search(sentence, FLAT).group(1))
    assert define(us, "eit_device.h") == seconds * 1_000_000
    elsewhere = {
        "EIT_LOCK_US": (store.LOCK_NS, specification.LOCK_S), "EIT_TRIAL_US": (device.TRIAL_NS, specification.TRIAL_S)
    }[us]  # fmt: skip
    assert elsewhere == (seconds * 1_000_000_000, seconds)


def test_pieces_are_as_long_as_it_says():
    chunk = define("EIT_CHUNK_BYTES", "eit_wire.h")
    assert chunk == messages.CHUNK_BYTES
    assert f"multiples of 4 bytes, at most {chunk}" in FLAT
    assert f"a piece of 1 to {chunk} bytes" in FLAT


def test_flags_of_hello_and_of_a_frame_are_listed_with_their_numbers():
    said = re.search(r"HELLO's flags: (.*?)\. `line_bytes", FLAT).group(1)
    assert [int(part.split()[0]) for part in said.split("; ")] == [int(flag) for flag in codes.HelloFlag]
    said = next(row for row in table("## 4. FRAME") if row[2] == "flags")[4]
    assert [int(part.split()[0]) for part in said.split("; ")] == [int(flag) for flag in codes.FrameFlag]
