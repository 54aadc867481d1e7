"""From record to message: numbers, when a map is copied, when a message may go without, and what a taker keeps."""

import numpy as np
import pytest

from eitskin.frame_record import STAGES, FrameRecord
from eitskin.messaging.frame import unpack_frame
from eitskin.messaging.frame_message import FrameMessages, LastMessage
from eitskin_proto.skin.skin import PAPER


@pytest.fixture
def memory():
    return np.full(1350, 0.25, np.float32)


@pytest.fixture
def record(memory):
    record = FrameRecord(memoryview(memory).cast("B"))
    record.sequence = record.map_sequence = 7
    record.solver, record.touched, record.events = "vd2t", True, ("lost",)
    record.lost, record.corrupt, record.withheld, record.overrun = 1, 2, 3, 4
    record.scanned_ns = -3_000_000
    return record


@pytest.fixture
def messages():
    return FrameMessages("paper/1", "b", "S-1", PAPER.grid.shape)


def packed(messages, record, short=False):
    messages.begin(record, short=short)
    return bytes(messages.finish(record))


def test_a_message_says_what_the_record_says(messages, record):
    frame = unpack_frame(packed(messages, record), 0)
    assert (frame.number, frame.sequence, frame.map_sequence, frame.solver) == (1, 7, 7, "vd2t")
    assert frame.counts == {"lost": 1, "corrupt": 2, "withheld": 3, "overrun": 4}
    assert (frame.events, frame.electrodes, frame.drift_percent) == (("lost",), (), None)
    assert list(frame.host_ns) == list(STAGES)
    assert frame.host_ns["pack"] <= frame.host_ns["publish"]
    assert frame.age_us >= 3000
    assert (frame.map == 0.25).all()


def test_a_frame_for_which_nothing_was_computed_has_a_map_of_zeros_whatever_the_memory_holds(messages, record):
    record.solver = "none"
    assert record.map_is_zero
    assert not unpack_frame(packed(messages, record), 0).map.any()


def test_a_taker_of_messages_in_this_process_keeps_a_copy(messages, record):
    here = LastMessage()
    messages.begin(record, short=here.short)
    here.send(messages.finish(record))
    kept = here.message
    record.sequence = 8
    packed(messages, record)
    assert unpack_frame(kept, 0).sequence == 7
