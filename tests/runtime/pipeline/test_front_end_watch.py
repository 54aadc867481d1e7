"""Frames that no living front end sends are withheld, with their reason; the next fit one says so."""

import numpy as np
import pytest

from eitskin.pipeline.intake import REPEAT_FRAMES
from eitskin.reference.captured import Reference
from eitskin_proto.wire.codes import FrameFlag

from .passing import go, payload


@pytest.fixture
def noisy(pipeline, counts):
    pipeline.use_reference(Reference(counts * 1e-9, np.abs(counts) * 3e-12, 100, "TEST-1", 0xABCD, "paper", ""))
    return pipeline


def test_rows_at_one_count_are_withheld_and_the_next_frame_says_so(noisy, counts):
    for number, value in enumerate((2**31 - 1, -(2**31), 1_000_000, 1)):
        assert not go(noisy, payload(np.full(104, value, dtype=np.int32), number))
    assert (noisy.intake.withheld["stuck"], noisy.intake.withheld["no_signal"]) == (3, 1)
    assert go(noisy, payload(counts, 9))
    assert {"withheld:stuck", "withheld:no_signal"} <= set(noisy.record.events)


def test_a_frame_that_comes_again_is_withheld_whichever_buffer_it_comes_from(noisy, counts, touched):
    assert go(noisy, payload(counts, 1))
    assert not go(noisy, payload(counts, 2))
    assert go(noisy, payload(touched, 3))
    assert not go(noisy, payload(counts, 4))
    assert not go(noisy, payload(touched, 5))
    assert noisy.intake.withheld["frozen"] == 3
    for number in range(REPEAT_FRAMES):
        other = counts.copy()
        other[0] += 1 + number
        assert go(noisy, payload(other, 6 + number))
    assert go(noisy, payload(counts, 100)), "what is long past is forgotten"
    assert "withheld:frozen" not in noisy.record.events


def test_a_frame_of_another_width_or_table_is_none_of_this_device(pipeline, counts):
    assert not go(pipeline, payload(counts // 2, 1, sample_bytes=3))
    assert not go(pipeline, payload(np.tile(counts, 2), 2, flags=FrameFlag.FULL))
    assert pipeline.intake.withheld["malformed"] == 2
    assert go(pipeline, payload(counts, 3))
