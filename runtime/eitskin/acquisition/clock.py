"""The device's clock in terms of the host's: when was this frame scanned?

A frame is read some delay after it was scanned; the delay varies, but is never negative. The smallest difference
between host and device clock over a second therefore comes from a frame that hardly waited, and the line through the
last such minima gives offset and drift::

    host - device |  x   x
                  | x  x   x  x      minima of each second, and a line through them
                  |___o______o____
                  |..a............   what TIME said: the line less the shortest delay
                  +---------------- device time

The shortest delay itself (encoding, the time on the wire) cannot be seen in frames alone. A question for the device's
time shows it: the answer was made between asking and hearing, so the offset is known to half the round trip. What the
line lies above it is the shortest delay of a frame, and is taken off.
"""

from collections import deque
from dataclasses import dataclass
from typing import Final

WINDOW_US: Final = 1_000_000
"""One minimum is kept a second."""

WINDOWS: Final = 16
"""Minima that the line goes through; a crystal's drift is steady over 16 s."""

MAX_DRIFT: Final = 1e-3
"""No crystal is off by more than 1000 ppm; a steeper line means too few or disturbed minima."""

MODULUS_US: Final = 1 << 32
"""The device's clock on the wire wraps."""


@dataclass(frozen=True, slots=True)
class TimeSample:
    """One answer to a question for the device's time."""

    device_us: int
    """u32 of the answer."""
    asked_ns: int
    """``perf_counter_ns`` before the question was written."""
    heard_ns: int
    """When the answer was in hand."""

    @property
    def round_trip_ns(self) -> int:
        """Between question and answer."""
        return self.heard_ns - self.asked_ns


class DeviceClock:
    """Estimates when a frame was scanned, on the host's ``perf_counter_ns``."""

    __slots__ = (
        "_anchor", "_anchor_elapsed_us", "_anchor_ns", "_drift", "_minima", "_offset_ns", "_origin_us", "_shift_ns",
        "_window_best", "_window_end_us",
    )  # fmt: skip

    def __init__(self) -> None:
        self._minima: deque[tuple[float, float]] = deque(maxlen=WINDOWS)
        self._anchor: TimeSample | None = None
        self.restart()

    def restart(self) -> None:
        """Forget everything, as after a reset of the device; a sample that is still unused belongs to its new clock."""
        self._minima.clear()
        self._origin_us = -1
        self._window_end_us = 0
        self._window_best = (0.0, 0.0)
        self._offset_ns = 0.0
        self._drift = 0.0
        self._anchor_elapsed_us = 0
        self._anchor_ns: float | None = None
        self._shift_ns = 0.0

    def anchor(self, sample: TimeSample | None) -> None:
        """Take an answer of the device, asked just before its stream; None if it gave none."""
        self._anchor = sample

    @property
    def drift_ppm(self) -> float:
        """By how much the host's clock runs faster than the device's."""
        return self._drift * 1e6

    @property
    def shortest_delay_us(self) -> float | None:
        """From the end of a scan to its last byte in hand, at best; None if the device was not asked for its time."""
        return None if self._anchor_ns is None else self._shift_ns / 1000

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
        if self._anchor is not None:
            self._hook(self._anchor, device_us)
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
            self._measure_shift()
        return device_us * 1000 + int(line - self._shift_ns)

    def _hook(self, sample: TimeSample, device_us: int) -> None:
        """Relate a sample to the first frame after it; between the two the u32 may have wrapped once."""
        self._anchor = None
        sampled_us = device_us - (device_us - sample.device_us) % MODULUS_US
        self._anchor_elapsed_us = sampled_us - self._origin_us
        self._anchor_ns = (sample.asked_ns + sample.heard_ns) / 2 - sampled_us * 1000.0
        self._measure_shift()

    def _measure_shift(self) -> None:
        """Compare the line with the sample, while the line still passes where the sample was taken."""
        if self._anchor_ns is not None and len(self._minima) < WINDOWS:
            there = self._offset_ns + self._drift * self._anchor_elapsed_us * 1000.0
            self._shift_ns = max(0.0, there - self._anchor_ns)

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
        self._measure_shift()
