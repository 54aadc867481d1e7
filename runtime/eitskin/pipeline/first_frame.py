"""The first frame that somebody asks for must not be an old one, also where nobody has read the line for a while.

A line that nobody reads fills up: it keeps the oldest frames, and the device leaves out those for which there is no
room. So what waits is old, and so is the newest of it, until the line has been read empty.
"""

from typing import Final

from eitskin.acquisition.clock import DeviceClock

OLD_S: Final = 0.1
"""A first frame that waited longer than this, beyond what the line takes by itself, is left out ..."""

ANY_S: Final = 1.0
"""... but none after this: then all of them are old, or the clocks do not agree."""


class FirstFrame:
    """Tells whether a frame may be the first one.

    Args:
        clock: Says when frames were scanned.
        now_ns: When somebody asked, on ``perf_counter_ns``.
    """

    __slots__ = ("_awaited", "_begun_ns", "_clock", "backlog")

    def __init__(self, clock: DeviceClock, now_ns: int) -> None:
        self._clock, self._begun_ns = clock, now_ns
        self._awaited = True
        self.backlog = True
        """What waits is from before somebody asked: of all that waits, the newest alone may be the first."""

    def is_old(self, scanned_ns: int, read_ns: int) -> bool:
        """Return whether a frame is too old to be the first; the one that is not is the first.

        Args:
            scanned_ns: When it was scanned.
            read_ns: When its last byte was in hand.
        """
        if not self._awaited:
            return False
        waited_ns = read_ns - scanned_ns - 1000.0 * (self._clock.shortest_delay_us or 0.0)
        self._awaited = self.backlog = waited_ns > 1e9 * OLD_S and read_ns - self._begun_ns < 1e9 * ANY_S
        return self._awaited
