import numpy as np

from eitskin.clock import DeviceClock


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


def test_without_the_drift_estimate_the_error_would_be_larger_than_the_tolerance():
    true_ns, device_us, read_ns = stream(40, drift=80e-6)
    constant = (read_ns - device_us * 1000)[:200].min()
    error_us = (device_us * 1000 + constant - true_ns)[-1] / 1000 - 300
    assert abs(error_us) > 1000


def test_no_frame_was_scanned_after_it_was_read():
    for seed in range(3):
        _, device_us, read_ns = stream(20, drift=-200e-6, seed=seed)
        clock = DeviceClock()
        for d, r in zip(device_us, read_ns, strict=True):
            assert clock.scanned_ns(int(d), int(r)) <= r


def test_a_reset_of_the_device_starts_the_estimate_anew():
    clock = DeviceClock()
    for index in range(1000):
        clock.scanned_ns(index * 5000, index * 5_000_000)
    clock.restart()
    assert clock.scanned_ns(10, 9_000_000_000) == 9_000_000_000
    assert clock.drift_ppm == 0.0
