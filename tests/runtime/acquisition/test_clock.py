import time

import numpy as np
import pytest

from eitskin.acquisition.device import DeviceClock, TimeSample
from eitskin.acquisition.serial_port import SerialPort
from eitskin.skin import Skin


def stream(seconds, drift, seed=0, rate_hz=200, offset_ns=5_000_000_000):
    rng = np.random.default_rng(seed)
    true_ns = np.arange(int(seconds * rate_hz)) * (10**9 // rate_hz) + offset_ns
    device_us = ((true_ns - offset_ns) * (1 - drift) / 1000).astype(int) + 123_456
    read_ns = true_ns + 300_000 + rng.exponential(400_000, len(true_ns)).astype(int)
    return true_ns, device_us, read_ns


def test_the_scan_time_follows_a_drifting_device_clock():
    true_ns, device_us, read_ns = stream(40, drift=80e-6)
    clock = DeviceClock()
    found = np.array([clock.scanned_ns(int(d), int(r)) for d, r in zip(device_us, read_ns, strict=True)])
    error_us = (found - true_ns)[len(found) // 2 :] / 1000 - 300  # the shortest delay cannot be seen from one side
    # The minimum of 200 exponential delays of 400 us lies about 2 us above the shortest
    assert np.abs(error_us).max() < 60
    assert abs(clock.drift_ppm - 80) < 5


def asked(true_ns, offset_ns, out_ns, back_ns, extra_us=123_456):
    """Return the sample of a question whose answer was made at a true time, with its way there and back."""
    return TimeSample(((true_ns - offset_ns) // 1000 + extra_us) % 2**32, true_ns - out_ns, true_ns + back_ns)


def test_a_question_for_the_time_shows_the_delay_that_frames_cannot():
    true_ns, device_us, read_ns = stream(12, drift=30e-6)
    clock = DeviceClock()
    clock.anchor(asked(true_ns[0] - 2_000_000, 5_000_000_000, 200_000, 200_000))
    found = np.array([clock.scanned_ns(int(d), int(r)) for d, r in zip(device_us, read_ns, strict=True)])
    late = slice(len(found) // 2, None)
    # The frames' shortest delay is 300 us. The first minimum of 200 lies 2 us above it; drift is only fitted after 8 s,
    # until when 30 ppm move the line by up to 240 us below the truth.
    assert abs((found - true_ns)[late]).max() / 1000 < 260
    assert abs((found - true_ns)[-100:]).max() / 1000 < 60
    assert clock.shortest_delay_us == pytest.approx(300, abs=60)
    assert (found <= read_ns).all()


def test_a_question_just_before_the_device_clock_wraps_is_understood_after_it():
    offset_ns, first_us = 5_000_000_000, 2**32 - 1000
    true_ns = np.arange(400) * 5_000_000 + offset_ns + 2_000_000
    device_us = ((true_ns - offset_ns) // 1000 + first_us) % 2**32  # the stream's first frame is after the wrap
    clock = DeviceClock()
    clock.anchor(TimeSample(first_us, offset_ns - 50_000, offset_ns + 50_000))
    found = [clock.scanned_ns(int(d), int(t) + 700_000) for d, t in zip(device_us, true_ns, strict=True)]
    assert device_us[0] < 2000
    assert clock.shortest_delay_us == pytest.approx(700, abs=1)
    assert np.abs(np.array(found) - true_ns).max() < 2000


class SlowForFrames(SerialPort):
    """A line on which frames take 20 ms longer than short answers do."""

    def read(self, timeout_s=None):
        data = super().read(timeout_s)
        if len(data) > 200:
            time.sleep(0.02)
        return data


def test_a_frames_age_includes_its_time_on_the_wire(virtual_skin, tiny):
    with virtual_skin(rate_hz=20.0) as port, Skin(SlowForFrames(port), bundle=tiny) as skin:
        skin.capture_reference(10)
        ages_us = [frame.age_us for _, frame in zip(range(10), skin.frames(timeout_s=120.0), strict=False)]
        delay_us = skin.status()["wire_delay_us"]
    # 20 ms on the line; half the round trip of an answer may be missing, and a busy machine only adds
    assert delay_us >= 19_000
    assert min(ages_us) >= 19_000
