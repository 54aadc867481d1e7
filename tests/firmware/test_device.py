"""The whole C device in memory: answers, streaming, overruns."""

from dataclasses import replace

import numpy as np

from eitskin_proto.sensor.table import TABLE
from eitskin_proto.wire import framing, messages
from eitskin_proto.wire.codes import Code, EventCode, FrameFlag
from eitskin_proto.wire.frames import Frame
from eitskin_tools.flash import procedure
from eitskin_tools.flash.exchange import Exchange

from .talk import FAST, talk


def test_it_streams_at_the_rate_in_table_order_with_saturation_where_it_was(device):
    rng = np.random.default_rng(0)
    counts = rng.integers(-(2**31), 2**31, (16, 16)).astype(np.int32)
    saturated = np.zeros(16, dtype=np.uint16)
    saturated[3] = 1 << 7
    device.set_counts(counts, saturated)
    answer, *frames = talk(device, messages.Start(tag=1), run_us=1_000_000)
    assert (answer.code, answer.detail) == (Code.OK, 0)
    assert 199 <= len(frames) <= 201
    assert [frame.sequence for frame in frames] == list(range(len(frames)))
    assert [bool(frame.flags & FrameFlag.FIRST) for frame in frames[:2]] == [True, False]
    steps = np.diff([frame.device_us for frame in frames])
    assert abs(steps - 5000).max() <= 50  # the clock of this test moves in steps of 50 us
    expected = [min((int(counts[k, m]) + 128) // 256, 2**23 - 1) for k, m in TABLE]
    assert frames[-1].counts.tolist() == expected
    assert frames[-1].saturation == 1 << TABLE.tolist().index([3, 7])


def test_the_rate_does_not_drift_even_if_its_period_is_no_whole_microsecond(device):
    exchange = Exchange(device)
    procedure.write(exchange, replace(FAST, rate_mHz=333_333))
    frames = [m for m in talk(device, messages.Start(), run_us=3_000_000) if isinstance(m, Frame)]
    span_us = frames[-1].device_us - frames[0].device_us
    assert abs(span_us - (len(frames) - 1) * 1e9 / 333_333) <= 100  # two steps of this test's clock, after 3 s


def test_a_line_without_room_loses_frames_that_are_counted_and_never_parts_of_them(device):
    device.limit_line(1000)  # two frames
    talk(device, messages.Start())
    device.run(100_000)
    kept = framing.Deframer().feed(device.take())
    after = [m for m in talk(device, run_us=10_000) if isinstance(m, Frame)]
    assert len(kept) == 2
    assert after[0].device_dropped == after[0].sequence - 2
    assert after[0].device_dropped > 10


def test_a_device_that_was_held_up_skips_scans_and_counts_them(device):
    talk(device, messages.Start(), run_us=10_000)
    device.run(42_000, step_us=42_000)  # nothing polled it for 42 ms
    said = talk(device, run_us=20_000)
    frames = [m for m in said if isinstance(m, Frame)]
    assert frames[-1].device_dropped >= 7
    assert frames[-1].sequence == frames[-1].device_us // 5000 or abs(frames[-1].sequence * 5000 - 72_000) < 10_000
    assert [m.code for m in said if isinstance(m, messages.Event)] == [EventCode.OVERRUN]


def test_a_broken_front_end_is_an_event_a_scan_and_no_frame(device):
    talk(device, messages.Start())
    device.break_front_end(True)
    said = talk(device, run_us=50_000)
    assert not [m for m in said if isinstance(m, Frame)][1:]
    assert {m.code for m in said if isinstance(m, messages.Event)} == {EventCode.FRONT_END_FAILED}
    device.break_front_end(False)
    again = [m for m in talk(device, run_us=50_000) if isinstance(m, Frame)]
    assert again[0].device_dropped >= 9


def test_the_clock_may_wrap_while_it_streams(device):
    device.set_clock(2**32 - 50_000)
    frames = [m for m in talk(device, messages.Start(), run_us=100_000) if isinstance(m, Frame)]
    steps = np.diff(np.array([frame.device_us for frame in frames], dtype=np.uint32))
    assert len(frames) >= 19
    assert np.abs(steps.astype(np.int64) - 5000).max() <= 50
    [answer] = [m for m in talk(device, messages.Stop(), messages.TimeRequest(tag=77)) if isinstance(m, messages.Time)]
    assert answer.tag == 77
    assert answer.device_us < 60_000


def test_the_count_of_dropped_scans_wraps_as_the_specification_says(device):
    device.limit_line(0)
    talk(device, messages.Start())
    for _ in range(66):  # 330 s: 66,000 scans at 200 a second, none of which the line takes
        device.run(5_000_000, step_us=1000)
    device.limit_line(65536)
    frames = [m for m in talk(device, run_us=20_000) if isinstance(m, Frame)]
    assert frames[0].sequence > 65_536
    assert frames[0].device_dropped == frames[0].sequence % 65_536
