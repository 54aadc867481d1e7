import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin_proto.errors import ProtocolError
from eitskin_proto.sensor.table import FULL_TABLE, TABLE
from eitskin_proto.wire import messages
from eitskin_proto.wire.frames import (
    HEADER,
    MAX_LOST,
    MODULUS,
    Frame,
    FrameView,
    StreamCounter,
    frame_bytes,
    full_scale,
    quantise,
)
from eitskin_proto.wire.framing import MAX_PAYLOAD
from eitskin_proto.wire.scan_rows import full_rows, row_count, table_rows


@st.composite
def any_frame(draw):
    flags = draw(st.integers(0, 15))
    drives = draw(st.integers(0, 0xFFFF).filter(lambda drives: row_count(bool(flags & 1), drives)))
    width = draw(st.sampled_from([2, 3, 4]))
    rows = row_count(bool(flags & 1), drives)
    limit = full_scale(width)
    seed = draw(st.integers(0, 2**32 - 1))
    counts = np.random.default_rng(seed).integers(-limit - 1, limit, rows, dtype=np.int32, endpoint=True)
    u32 = st.integers(0, 0xFFFFFFFF)
    return Frame(
        sequence=draw(u32), device_us=draw(u32), counts=counts, generation=draw(u32), sample_bytes=width, flags=flags,
        drives=drives, device_dropped=draw(st.integers(0, 0xFFFF)), saturation=draw(st.integers(0, 2**rows - 1)),
    )  # fmt: skip


def same(a, b):
    names = [name for name in Frame.__slots__ if name != "counts"]
    return all(getattr(a, name) == getattr(b, name) for name in names) and np.array_equal(a.counts, b.counts)


@given(any_frame())
@settings(max_examples=80, deadline=None)
def test_every_frame_survives_the_wire(frame):
    payload = frame.pack()
    assert len(payload) == frame_bytes(len(frame.counts), frame.sample_bytes) <= MAX_PAYLOAD
    assert same(messages.unpack(payload), frame)


@pytest.mark.parametrize("width", [2, 3, 4])
def test_the_ends_of_the_scale_keep_their_sign(width):
    limit = full_scale(width)
    counts = np.zeros(104, dtype=np.int32)
    counts[:5] = [limit, -limit - 1, -1, 1, 0]
    assert np.array_equal(Frame.unpack(Frame(0, 0, counts, sample_bytes=width).pack()).counts, counts)


def test_decoding_allocates_no_arrays():
    # tracemalloc sees numpy's data; 2000 decoded frames may keep nothing and peak below a single frame's counts (416 B)
    # plus the few small Python objects of one call.
    payloads = [Frame(i, i, np.arange(104, dtype=np.int32), sample_bytes=w).pack() for i, w in enumerate([2, 3, 4])]
    for payload in payloads:
        view = FrameView()
        view.load(payload)
        tracemalloc.start()
        for _ in range(2000):
            view.load(payload)
        kept, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert kept < 1500
        assert peak < 3000


@given(any_frame(), st.data())
@settings(max_examples=60, deadline=None)
def test_a_frame_of_any_other_length_is_refused(frame, data):
    payload = frame.pack()
    cut = data.draw(st.integers(0, len(payload) - 1))
    for wrong in (payload[:cut], payload + bytes(1 + cut)):
        with pytest.raises(ProtocolError):
            Frame.unpack(wrong)


def test_what_a_header_claims_must_fit_together():
    payload = bytearray(Frame(0, 0, np.zeros(104, dtype=np.int32), sample_bytes=2).pack())
    for at, value, text in [(2, 1, "samples of 1 bytes"), (2, 3, "expected 345"), (3, 103, "has 103 rows"),
                            (1, 1, "104 rows, but its drives 0xffff have 208"), (0, 0x81, "not a FRAME")]:  # fmt: skip
        wrong = payload.copy()
        wrong[at] = value
        with pytest.raises(ProtocolError, match=text):
            FrameView().load(bytes(wrong))
    none = bytearray(HEADER.pack(0x82, 0, 2, 0, 0, 0, 0, 0, 0))
    with pytest.raises(ProtocolError, match="has 0 rows"):
        FrameView().load(bytes(none))


def test_saturation_beyond_the_rows_is_refused_on_both_sides():
    counts = np.zeros(row_count(False, 1), dtype=np.int32)  # 13 rows, 2 bytes of saturation
    payload = bytearray(Frame(0, 0, counts, drives=1, sample_bytes=2).pack())
    payload[-1] = 0x20
    with pytest.raises(ProtocolError, match="rows beyond its 13"):
        FrameView().load(bytes(payload))
    with pytest.raises(ValueError, match="beyond the 13"):
        Frame(0, 0, counts, drives=1, sample_bytes=2, saturation=1 << 13).pack()


def test_quantising_rounds_cuts_off_and_says_which_rows():
    volts = np.array([0.0, 0.4, 0.6, -0.6, 40_000.0, -40_000.0, np.nan, np.inf, 32_767.0])
    counts, saturation = quantise(volts, 1.0, 2)
    assert counts.tolist() == [0, 0, 1, -1, 32767, -32767, 0, 32767, 32767]
    assert saturation == 0b011110000


def test_all_drives_give_the_tables_and_a_subset_keeps_their_order():
    assert np.array_equal(FULL_TABLE[full_rows(False, 0xFFFF)], TABLE)
    assert np.array_equal(full_rows(True, 0xFFFF), np.arange(208))
    rows = FULL_TABLE[full_rows(False, 0x0111)]
    assert rows.tolist() == [pair for pair in TABLE.tolist() if pair[0] in (0, 4, 8)]


def test_rows_of_a_full_frame_map_to_the_table_by_reciprocity():
    pairs = TABLE[table_rows(True, 0xFFFF)]
    assert np.array_equal(np.sort(pairs, axis=1), np.sort(FULL_TABLE, axis=1))
    assert np.array_equal(table_rows(False, 0xFFFF), np.arange(104))
    assert np.bincount(table_rows(True, 0xFFFF)).tolist() == [2] * 104


@given(
    st.integers(0, MODULUS - 1),
    st.integers(0, MODULUS - 1),
    st.lists(st.tuples(st.integers(1, 900_000), st.integers(0, MODULUS - 1)), min_size=1, max_size=50),
)
@settings(max_examples=80, deadline=None)
def test_unwrapped_counters_equal_the_true_ones_over_any_wrap(first, first_us, moves):
    counter = StreamCounter()
    counter.step(first, first_us)
    sequence, device_us, lost = first, first_us, 0
    for forward, elapsed_us in moves:
        sequence, device_us, lost = sequence + forward, device_us + elapsed_us, lost + forward - 1
        step = counter.step(sequence % MODULUS, device_us % MODULUS)
        assert (step.sequence, step.device_us, step.lost) == (sequence, device_us, forward - 1)
        assert not step.reset
        assert not step.duplicate
    assert counter.lost == lost


def test_a_sequence_that_falls_back_is_a_reset_and_counts_no_loss():
    counter = StreamCounter()
    for sequence in (500, 501, 502):
        counter.step(sequence, sequence * 5000)
    step = counter.step(0, 4000)
    assert (step.reset, step.lost, step.sequence, step.device_us) == (True, 0, 0, 4000)
    assert (counter.resets, counter.lost) == (1, 0)
    assert counter.step(1, 9000).lost == 0


def test_a_gap_of_the_largest_size_is_loss_and_one_more_is_a_reset():
    for lost, reset in ((MAX_LOST, False), (MAX_LOST + 1, True)):
        counter = StreamCounter()
        counter.step(7, 0)
        step = counter.step(8 + lost, 1)
        assert (step.reset, step.lost) == (reset, 0 if reset else lost)


def test_the_same_frame_twice_is_a_duplicate_that_changes_nothing():
    counter = StreamCounter()
    counter.step(3, 100)
    for device_us in (100, 999):
        step = counter.step(3, device_us)
        assert (step.duplicate, step.device_us, step.lost) == (True, 100, 0)
    assert counter.step(4, 200).device_us == 200
