"""From u32 counters that wrap to plain integers, with lost frames counted and resets recognised.

The device counts scans and microseconds modulo 2^32. The microseconds wrap after 71.6 minutes, the sequence after 248
days at 200 frames/s. Between two frames the sequence moves forward by 1 plus what was lost; anything that is not a
plausible step forward is a reset of the device, which starts both counters anew. No clock of the host is involved.
"""

from typing import Final, NamedTuple

MODULUS: Final = 1 << 32

MAX_LOST: Final = 1_000_000
"""More lost frames than this (83 minutes at 200 frames/s) is taken for a reset."""


class Step(NamedTuple):
    """What one frame's counters say; a tuple, since a frozen dataclass costs 3 us more a frame."""

    sequence: int
    """Unwrapped: grows over wraps; starts anew after a reset."""
    device_us: int
    """Unwrapped microseconds, likewise."""
    lost: int
    """Frames between the last one and this one that never came."""
    reset: bool
    """The device started anew since the last frame."""
    duplicate: bool
    """The same sequence number as the last frame, at no earlier time: the counters are unchanged."""


class StreamCounter:
    """Follows one stream's sequence and device time.

    Args:
        max_lost: A larger gap is a reset.
    """

    __slots__ = ("_device_us", "_max_lost", "_sequence", "lost", "resets")

    def __init__(self, max_lost: int = MAX_LOST) -> None:
        self._max_lost = max_lost
        self._sequence: int | None = None
        self._device_us = 0
        self.lost = 0
        """Frames lost so far."""
        self.resets = 0
        """Resets seen so far."""

    @property
    def sequence(self) -> int | None:
        """Unwrapped, of the last frame; None before the first."""
        return self._sequence

    @property
    def device_us(self) -> int:
        """Unwrapped microseconds of the last frame."""
        return self._device_us

    def restart(self) -> None:
        """Forget the last frame, as after a handshake with a device that is known to have restarted."""
        self._sequence = None

    def step(self, sequence: int, device_us: int) -> Step:
        """Return what the next frame's counters say.

        Args:
            sequence: u32 of the frame.
            device_us: u32 of the frame.
        """
        if self._sequence is None:
            self._sequence, self._device_us = sequence, device_us
            return Step(sequence, device_us, 0, False, False)
        forward = (sequence - self._sequence) % MODULUS
        earlier = (device_us - self._device_us) % MODULUS > MODULUS // 2
        if forward == 0 and not earlier:
            return Step(self._sequence, self._device_us, 0, False, True)
        if forward == 0 or forward - 1 > self._max_lost:
            self.resets += 1
            self._sequence, self._device_us = sequence, device_us
            return Step(sequence, device_us, 0, True, False)
        self._sequence += forward
        self._device_us += (device_us - self._device_us) % MODULUS
        self.lost += forward - 1
        return Step(self._sequence, self._device_us, forward - 1, False, False)
