from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin_proto.errors import ProtocolError
from eitskin_proto.wire import config_toml, hardware
from eitskin_proto.wire.config import BLOB_BYTES, Configuration
from eitskin_proto.wire.framing import crc32c
from eitskin_proto.wire.scan_rows import row_count

PAPER = config_toml.named("paper")
BAUD_921600 = 92_160.0


@st.composite
def any_configuration(draw):
    rows = draw(st.sampled_from([104, 208]))
    drives = st.integers(1, 0xFFFF).filter(lambda drives: row_count(rows == 208, drives))
    idle = draw(st.none() | drives)
    u16, u32 = st.integers(1, 0xFFFF), st.integers(1, 0xFFFFFFFF)
    rate = st.integers(1, 4_000_000_000)
    skin = draw(st.just("") | st.integers(1, 2**64 - 1).map("{:016x}".format))
    longest = 8 if skin else 16
    return Configuration(
        name=draw(st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), min_size=1, max_size=longest)),
        skin=skin,
        revision=draw(u32), hardware_id=hardware.EITSKIN_16.id, frequency_hz=draw(u32), current_ua=draw(u32),
        settle_us=draw(u16), averages=draw(u16), gain=draw(u16), sample_bytes=draw(st.sampled_from([2, 3, 4])),
        rows=rows, drives=draw(drives), rate_mHz=draw(rate), idle_drives=idle or 0,
        idle_rate_mHz=draw(rate) if idle else 0,
    )  # fmt: skip


@given(any_configuration())
@settings(max_examples=80, deadline=None)
def test_value_blob_and_toml_say_the_same(configuration):
    blob = configuration.to_blob()
    assert len(blob) == BLOB_BYTES == 64
    assert Configuration.from_blob(blob) == configuration
    assert configuration.digest == crc32c(blob[:-4])
    assert config_toml.parse(config_toml.to_toml(configuration)) == configuration


def test_every_field_changes_the_digest():
    for field, value in {"name": "other", "revision": 9, "frequency_hz": 1, "current_ua": 1, "settle_us": 1, "gain": 1,
                         "averages": 1, "sample_bytes": 2, "rows": 208, "drives": 1, "rate_mHz": 1,
                         "idle_drives": 1, "idle_rate_mHz": 1, "hardware_id": 1,
                         "skin": "00000000000000ab"}.items():  # fmt: skip
        assert replace(PAPER, **{field: value}).digest != PAPER.digest


@pytest.mark.parametrize("name", config_toml.NAMED)
def test_the_named_configurations_run_on_the_known_electronics_at_921600_baud(name):
    configuration = config_toml.named(name)
    assert configuration.name == name
    configuration.check(BAUD_921600)


def test_the_paper_configuration_is_the_papers():
    assert (PAPER.frequency_hz, PAPER.frame_rows, PAPER.full) == (20_000, 104, False)
    assert config_toml.named("full208").frame_rows == 208
    assert config_toml.named("idle").frame_rows == 13 + 13 + 12 + 11
    assert config_toml.named("fast").rate_hz > PAPER.rate_hz


@pytest.mark.parametrize("sample_bytes", [2, 3, 4])
@pytest.mark.parametrize("baud", [115_200, 460_800, 921_600, 3_000_000])
def test_the_largest_rate_that_is_named_is_accepted_and_a_thousandth_more_is_not(sample_bytes, baud):
    quick = replace(PAPER, sample_bytes=sample_bytes, settle_us=20, averages=1, frequency_hz=100_000)
    with pytest.raises(ValueError, match="reaches at most") as caught:
        replace(quick, rate_mHz=4_000_000_000).check(baud / 10)
    largest = round(1000 * float(str(caught.value).split("at most ")[1].split()[0]))
    replace(quick, rate_mHz=largest).check(baud / 10)
    with pytest.raises(ValueError, match="reaches at most"):
        replace(quick, rate_mHz=largest + 1).check(baud / 10)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"frequency_hz": 500}, "frequency_Hz is 500, eitskin-16 drives 1000 to 100000"),
        ({"current_ua": 6000}, "current_uA is 6000, eitskin-16 drives at most 5000"),
        ({"gain": 3}, "gain is 3, eitskin-16 has 1, 2, 4"),
        ({"settle_us": 19}, "settle_us is 19, eitskin-16 needs at least 20"),
        ({"hardware_id": 7}, "hardware 0x00000007 is unknown"),
    ],
)
def test_what_the_electronics_cannot_do_is_refused_with_what_they_can(change, text):
    with pytest.raises(ValueError, match=text):
        replace(PAPER, **change).check()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"name": ""}, "1 to 16 printable"),
        ({"name": "seventeen letters"}, "1 to 16 printable"),
        ({"name": "Schön"}, "1 to 16 printable"),
        ({"rows": 103}, "expected 104 .* or 208"),
        ({"sample_bytes": 1}, "expected 16, 24 or 32"),
        ({"drives": 0}, "drives is 0, expected 1"),
        ({"drives": 0xC000}, "have no row in the table of 104"),
        ({"rate_mHz": 0}, "rate_mHz is 0"),
        ({"averages": 0}, "averages is 0, expected 1 to 65535"),
        ({"idle_drives": 0}, "needs both drives and a rate, or neither"),
        ({"idle_drives": 0x8000}, "idle drives 0x8000 have no row"),
    ],
)
def test_a_configuration_that_means_nothing_cannot_be_made(change, text):
    with pytest.raises(ValueError, match=text):
        replace(PAPER, **change)


def resealed(blob, **at):
    body = bytearray(blob[:-4])
    for position, value in at.values():
        body[position] = value
    return bytes(body) + crc32c(bytes(body)).to_bytes(4, "little")


def test_a_blob_is_refused_for_what_is_wrong_with_it():
    blob = PAPER.to_blob()
    with pytest.raises(ProtocolError, match="expected b'EITC'"):
        Configuration.from_blob(b"JUNK" + blob[4:])
    with pytest.raises(ProtocolError, match="format 2, this release reads format 1"):
        Configuration.from_blob(resealed(blob, format=(4, 2)))
    with pytest.raises(ProtocolError, match="63 bytes, expected 64"):
        Configuration.from_blob(blob[:-1])
    with pytest.raises(ProtocolError, match="damaged"):
        Configuration.from_blob(blob[:-1] + bytes([blob[-1] ^ 1]))
    with pytest.raises(ProtocolError, match="impossible: rows is 105"):
        Configuration.from_blob(resealed(blob, rows=(5, 105)))
    for flags in (2, 3, 0x80):
        with pytest.raises(ProtocolError, match=f"flags {flags}, expected 64 and 0 or 1"):
            Configuration.from_blob(resealed(blob, flags=(59, flags)))
    with pytest.raises(ProtocolError, match="impossible: skin is '0000000000000000'"):
        Configuration.from_blob(resealed(blob, flags=(59, 1)))
    with pytest.raises(ProtocolError, match="impossible"):
        Configuration.from_blob(resealed(blob, name=(16, 0xC3)))


def test_a_skin_shares_the_name_s_place_and_nothing_else_moves():
    for name in config_toml.NAMED:
        plain = config_toml.named(name)
        stated = replace(plain, skin="0123456789abcdef")
        blob, other = plain.to_blob(), stated.to_blob()
        assert [at for at in range(60) if blob[at] != other[at]] == [*range(24, 32), 59]
        assert (other[24:32].hex(), other[59]) == (stated.skin, 1)
    for skin in ("0" * 16, "0123456789ABCDEF", "12", "0123456789abcdef0", "0123456789abcdeg"):
        with pytest.raises(ValueError, match=f"skin is {skin!r}, expected a digest of 16 hex digits"):
            replace(PAPER, skin=skin)
    with pytest.raises(ValueError, match="name is 'ninechars', expected at most 8 characters beside a skin"):
        replace(PAPER, name="ninechars", skin="0123456789abcdef")


TOML = config_toml.to_toml(PAPER)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("frequency_Hz = 20000", "frequency_kHz = 20", r"\[drive\] lacks frequency_Hz, .* by 'frequency_kHz'\?"),
        ("settle_us", "settle_ms", r"\[measure\] lacks settle_us, .* by 'settle_ms'\?"),
        ("gain = 8", "gain = 8\ncolour = 1", r"unknown key 'colour' in \[measure\]; known are sample_bits, settle_us"),
        ("current_uA = 1000", "", r"\[drive\] lacks current_uA, expected a whole number"),
        ("gain = 8", "gain = 8.5", r"\[measure\] gain is 8.5, expected a whole number"),
        ("gain = 8", "gain = true", r"\[measure\] gain is True, expected a whole number"),
        ("rate_Hz = 200.0", 'rate_Hz = "fast"', r"\[scan\] rate_Hz is 'fast', expected a number from 0.001 to 4e\+06"),
        ("rate_Hz = 200.0", "rate_Hz = nan", r"\[scan\] rate_Hz is nan, expected"),
        ("rate_Hz = 200.0", "rate_Hz = -1.0", r"\[scan\] rate_Hz is -1.0, expected"),
        ("sample_bits = 24", "sample_bits = 12", "sample_bits is 12, expected 16, 24 or 32"),
        ("[0, 1, 2, 3]", "[0, 4, 16]", "drive 16 does not exist"),
        ("[0, 1, 2, 3]", "[0, 4, 4]", "drive 4 is in the list twice"),
        ("[0, 1, 2, 3]", "[0, 4.5]", r"drives\[1\] is 4.5, expected a whole number"),
        ("[scan]", "[sweep]", "unknown key 'sweep' in the file; known are .*scan, idle"),
        ("[drive]", "[drive", "not a TOML file"),
        ("format = 1", "format = 2", "format is 2, this release reads format 1"),
        ('"eitskin-16"', '"eitskin-99"', "hardware 'eitskin-99' is unknown; known are 'eitskin-16'"),
    ],
)
def test_a_mistake_in_a_file_is_named(tmp_path, old, new, text):
    assert old in TOML
    file = tmp_path / "mine.toml"
    file.write_text(TOML.replace(old, new))
    with pytest.raises(ValueError, match=rf"mine\.toml: .*{text}"):
        config_toml.load(file)


def test_electronics_are_named_and_unknown_ones_by_their_digits():
    assert (hardware.name_of(PAPER.hardware_id), hardware.name_of(5)) == ("eitskin-16", "0x00000005")
