"""Of what waits when frames are asked for, the newest frame is computed, whatever the device says behind it."""

import time
from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest

from eitskin.frame_loop import FrameSource
from eitskin_proto.wire.codes import EventCode
from eitskin_proto.wire.messages import Event

from .passing import payload

FAILED = Event(EventCode.FRONT_END_FAILED).pack()


class Line:
    """A device that was greeted, on a line in which payloads wait."""

    silence_s, patience_s, time_sample = 60.0, 0.0, None
    stopping = False

    def __init__(self, *batches):
        self.batches, self.held = deque(batches), deque()
        self.transport = SimpleNamespace(name="line")

    def start(self):
        pass

    def payloads(self, timeout_s):
        self.read_ns = time.perf_counter_ns()
        return self.batches.popleft() if self.batches else []


@pytest.fixture
def frames(counts):
    """Return a maker of frames, each unlike the others."""

    def make(sequence):
        return payload(counts + np.arange(104, dtype=np.int32) * sequence, sequence)

    return make


def accepted(pipeline, *batches, frames=1):
    """Return the sequence numbers of the first frames that a source lets through."""
    source, found = FrameSource(Line(*batches), pipeline), []
    for _ in source.accepted(time.perf_counter_ns() + 20_000_000_000):
        found.append(pipeline.record.sequence)
        if len(found) == frames:
            break
    return found


@pytest.mark.parametrize("behind", [[], [FAILED], [FAILED, FAILED]])
def test_the_newest_frame_is_computed_whatever_comes_behind_it(pipeline, frames, behind):
    assert accepted(pipeline, [frames(1), FAILED, frames(2)], [frames(3), *behind]) == [3]
    assert pipeline.intake.withheld["stale"] == 2
    assert pipeline.intake.counter.lost == 0
    pipeline.intake.name_events()
    assert "device:front_end_failed" in pipeline.record.events
