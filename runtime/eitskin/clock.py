"""The device's clock in terms of the host's: when was this frame scanned?

A frame is read some delay after it was scanned; the delay varies, but is never negative. The smallest difference
between host and device clock over a second therefore comes from a frame that hardly waited, and the line through the
last such minima gives offset and drift. The shortest delay itself cannot be seen from one side: an age is counted
against the fastest frames, not against the true instant. ::

    host - device |  x   x
                  | x  x   x  x      minima of each second, and a line through them
                  |___o______o____
                  +---------------- device time
"""

from collections import deque
from typing import Final

WINDOW_US: Final = 1_000_000
"""One minimum is kept a second."""

WINDOWS: Final = 16
"""Minima that the line goes through; a crystal's drift is steady over 16 s."""

MAX_DRIFT: Final = 1e-3
"""No crystal is off by more than 1000 ppm; a steeper line means too few or disturbed minima."""


class DeviceClock:
    """Estimates when a frame was scanned, on the host's ``perf_counter_ns``."""

    __slots__ = ("_drift", "_minima", "_offset_ns", "_origin_us", "_window_best", "_window_end_us")

    def __init__(self) -> None:
        self._minima: deque[tuple[float, float]] = deque(maxlen=WINDOWS)
        self.restart()

    def restart(self) -> None:
        """Forget everything, as after a reset of the device."""
        self._minima.clear()
        self._origin_us = -1
        self._window_end_us = 0
        self._window_best = (0.0, 0.0)
        self._offset_ns = 0.0
        self._drift = 0.0

    @property
    def drift_ppm(self) -> float:
        """By how much the host's clock runs faster than the device's."""
        return self._drift * 1e6

    def scanned_ns(self, device_us: int, read_ns: int) -> int:
        """Return when a frame was scanned, never later than it was read.

        Args:
            device_us: Unwrapped device time of the frame.
            read_ns: When its last byte was read.
        """
        if self._origin_us < 0:
            self._origin_us = device_us
            self._window_end_us = device_us + WINDOW_US
            self._window_best = (0.0, float(read_ns - device_us * 1000))
            self._offset_ns = self._window_best[1]
        elapsed_us = device_us - self._origin_us
        difference = float(read_ns - device_us * 1000)
        if difference < self._window_best[1]:
            self._window_best = (float(elapsed_us), difference)
        if device_us >= self._window_end_us:
            self._close_window(device_us, elapsed_us, difference)
        line = self._offset_ns + self._drift * elapsed_us * 1000.0
        if difference < line:  # faster than every frame before: the line was too high
            self._offset_ns -= line - difference
            line = difference
        return device_us * 1000 + int(line)

    def _close_window(self, device_us: int, elapsed_us: int, difference: float) -> None:
        self._minima.append(self._window_best)
        self._window_end_us = device_us + WINDOW_US
        self._window_best = (float(elapsed_us), difference)
        count = len(self._minima)
        mean_t = sum(t for t, _ in self._minima) / count
        mean_d = sum(d for _, d in self._minima) / count
        spread = sum((t - mean_t) ** 2 for t, _ in self._minima)
        slope = sum((t - mean_t) * (d - mean_d) for t, d in self._minima) / (spread * 1000.0) if spread else 0.0
        steady = count >= WINDOWS // 2 and abs(slope) <= MAX_DRIFT
        self._drift = slope if steady else 0.0
        # The line touches the lowest minimum from below, so that no frame is scanned after it was read.
        self._offset_ns = min(d - self._drift * t * 1000.0 for t, d in self._minima)
