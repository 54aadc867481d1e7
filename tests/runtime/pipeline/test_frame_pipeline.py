from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.wire.frames import Frame
from eitskin_proto.wire.scan_rows import row_count

from .passing import go, payload


def test_a_touched_frame_is_computed_and_an_untouched_one_is_not(pipeline, counts, touched):
    assert go(pipeline, payload(touched, 1))
    assert pipeline.record.touched
    assert pipeline.record.solver == "vd2t"
    assert np.frombuffer(pipeline.record.map, np.float32).max() > 0
    assert go(pipeline, payload(counts, 2))
    assert not pipeline.record.touched
    assert pipeline.record.solver == "none"
    assert "inference:untouched" in pipeline.record.skipped
    assert not any(pipeline.record.map)


def test_a_frame_that_nobody_wants_is_only_judged(pipeline, touched):
    assert go(pipeline, payload(touched, 1), wanted=False)
    assert pipeline.record.touched
    assert (pipeline.record.solver, pipeline.record.skipped[0]) == ("none", "inference:no_subscriber")


def test_frames_that_are_not_fit_are_withheld_each_with_its_reason(pipeline, counts):
    some = replace(Frame(1, 1, counts), drives=0x0005, counts=counts[: row_count(False, 0x0005)])
    assert go(pipeline, payload(counts, 1))
    assert not go(pipeline, payload(counts, 1))
    assert not go(pipeline, payload(counts, 2, generation=3))
    assert not go(pipeline, replace(some, sequence=3).pack())
    assert not go(pipeline, payload(counts, 4)[:-1])
    assert not go(pipeline, b"\x82")
    pipeline.normaliser.use_scale(float("nan"))
    assert not go(pipeline, payload(counts, 5))
    assert pipeline.intake.withheld == {
        "malformed": 2, "duplicate": 1, "configuration": 1, "partial": 1, "implausible": 1, "no_signal": 0,
        "stuck": 0, "frozen": 0, "reversed": 0, "unlike": 0, "stale": 0,
    }  # fmt: skip
    assert pipeline.intake.generation_differs


def test_a_frame_without_any_voltage_is_no_touch_and_the_next_frame_says_why_it_was_withheld(pipeline, counts, touched):
    assert not go(pipeline, payload(0 * counts, 1))  # dV = -1 everywhere: once published as a touch
    assert not go(pipeline, payload(0 * counts, 2))
    assert pipeline.intake.withheld["no_signal"] == 2
    assert go(pipeline, payload(touched, 3))
    assert pipeline.record.events.count("withheld:no_signal") == 1
    assert go(pipeline, payload(touched, 4))
    assert not any("withheld" in event for event in pipeline.record.events)
    # A sheet that is touched all over keeps a fiftieth of its voltages: that is a signal.
    assert go(pipeline, payload((counts // 50).astype(counts.dtype), 5))


class Broken:
    """An engine whose answer is not finite."""

    name = "vd2t"

    def __init__(self, buffers, value):
        self.buffers, self.value = buffers, value

    def infer(self):
        self.buffers.map[0, 77] = self.value


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_map_that_is_not_finite_is_never_published(pipeline, touched, value):
    pipeline.engines[0] = Broken(pipeline.buffers, value)
    assert not go(pipeline, payload(touched, 1))
    assert pipeline.intake.withheld["implausible"] == 1


def test_lost_frames_resets_and_saturation_are_events_of_their_frame(pipeline, counts):
    assert go(pipeline, payload(counts, 10))
    assert pipeline.record.events == ()
    assert go(pipeline, payload(counts, 13))
    assert pipeline.record.events == ("lost",)
    assert pipeline.counter.lost == 2
    assert go(pipeline, payload(counts, 14, saturation=0b101))
    assert pipeline.record.events == ("saturated",)
    assert go(pipeline, payload(counts, 0))
    assert pipeline.record.events == ("device_reset",)
    assert go(pipeline, payload(counts, 1))
    assert pipeline.record.events == ()
