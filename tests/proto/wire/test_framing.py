import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin_proto.wire.framing import MAX_PAYLOAD, Deframer, crc32c, encode, wire_bytes


def test_crc_is_castagnoli():
    assert crc32c(b"123456789") == 0xE3069283  # RFC 3720's check value
    assert crc32c(bytes(32)) == 0x8A9136AA  # RFC 3720, B.4: 32 bytes of zeros
    assert crc32c(b"\xff" * 32) == 0x62A8AB43


@pytest.mark.parametrize("fill", [0x00, 0x01, 0xFF])
def test_every_length_arrives_and_takes_no_more_than_announced(fill):
    for length in range(1, MAX_PAYLOAD + 1):
        payload = bytes([fill]) * length
        packet = encode(payload)
        assert packet.count(0) == 1
        assert packet[-1] == 0
        assert len(packet) <= wire_bytes(length)
        assert Deframer().feed(packet) == [payload]


@pytest.mark.parametrize("length", [0, MAX_PAYLOAD + 1])
def test_a_payload_that_cannot_be_sent_is_refused(length):
    with pytest.raises(ValueError, match=rf"{length} bytes.*1 to {MAX_PAYLOAD}"):
        encode(bytes(length))


@given(st.lists(st.binary(min_size=1, max_size=300), max_size=8), st.data())
@settings(max_examples=100, deadline=None)
def test_any_way_of_cutting_the_stream_gives_the_same_payloads(payloads, data):
    stream = b"".join(map(encode, payloads))
    deframer, received, at = Deframer(), [], 0
    while at < len(stream):
        step = data.draw(st.integers(1, 64))
        received += deframer.feed(stream[at : at + step])
        at += step
    assert received == payloads
    assert (deframer.packets, deframer.corrupt, deframer.discarded_bytes) == (len(payloads), 0, 0)


@given(st.binary(max_size=2000), st.binary(min_size=1, max_size=400))
@settings(max_examples=80, deadline=None)
def test_after_garbage_and_one_delimiter_the_next_packet_is_not_shifted(garbage, payload):
    deframer = Deframer()
    deframer.feed(garbage + b"\0")
    assert deframer.feed(encode(payload)) == [payload]


def test_memory_is_bounded_when_no_delimiter_ever_comes():
    deframer = Deframer(max_payload=100)
    for _ in range(1000):
        deframer.feed(b"\x55" * 999)
        assert deframer.pending_bytes <= wire_bytes(100)
    assert deframer.discarded_bytes == 999_000
    assert deframer.feed(b"\0" + encode(b"after the flood")) == [b"after the flood"]


def test_a_packet_of_the_largest_size_passes_and_one_byte_more_is_dropped_and_counted():
    for fill in (0, 0xFF):
        deframer = Deframer(max_payload=100)
        deframer.feed(b"\0")
        assert deframer.feed(encode(bytes([fill]) * 100)) == [bytes([fill]) * 100]
        assert deframer.feed(encode(bytes([fill]) * 101) + encode(b"next")) == [b"next"]
        assert deframer.corrupt == 1
        assert deframer.discarded_bytes == wire_bytes(101) - 1
