"""What a recorded demonstration is scored as, without any process."""

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_tools.demo.recorder import Record
from eitskin_tools.demo.score import accuracy, timing
from eitskin_tools.scripted_scene.script import demonstration


def a_record(frames=400, first_us=1000000):
    """A record of perfect maps of the script, 20 frames a second, every stage 10 us, the wire 100 us."""
    script = demonstration()
    found = Record.empty(frames, PAPER.grid.shape)
    for index in range(frames):
        found.sequence[index] = 7 + index
        time_us = 20_000 + 50_000 * index
        found.device_us[index] = first_us + time_us
        found.maps[index] = script.truth_at(time_us * 1e-6)
        found.touched[index] = bool(script.scene_at(time_us * 1e-6).touches)
    found.host_ns[:] = found.device_us[:, None] * 1000 + 100_000 + 10_000 * np.arange(7)
    found.received_ns[:] = found.host_ns[:, -1] + 50_000
    return found


def test_scores_of_a_perfect_stream_are_perfect():
    found = accuracy(a_record(), demonstration(), start_us=1_000_000)
    assert found.cc_median == found.cc_median_flat == found.cc_median_bent == 1.0
    assert (found.missed, found.false_alarms) == (0.0, 0.0)
    assert found.scored > 250


def test_truth_taken_at_the_wrong_time_is_noticed():
    found = accuracy(a_record(), demonstration(), start_us=500_000)
    assert found.cc_median is not None
    assert found.cc_median < 0.95


def test_timing_counts_from_the_wire_and_sums_up_over_the_stages():
    record = a_record()
    record.sequence[200:] += 3  # three frames were lost
    wire = np.zeros(1 << 12, dtype=np.int64)
    wire[record.sequence] = record.device_us * 1000
    wire[207:209] = -1  # two of them had no room on the line; the third was damaged by the second
    found = timing(record, wire)
    assert (found["lost"], found["overruns"]) == (3, 2)
    assert found["rate_hz"] == pytest.approx(20.0, rel=1e-6)
    assert found["latency_us"] == {"p50": 210.0, "p99": 210.0, "p999": 210.0, "max": 210.0}
    spans = {name: stage["p50"] for name, stage in found["stages_us"].items()}
    assert spans["wire"] == 100.0
    assert spans["deliver"] == 50.0
    assert sum(spans.values()) == pytest.approx(found["latency_us"]["p50"])
