"""Does a stream keep its pace? What the device measured must be published while it is measured, not some time later.

A runtime that takes longer for a frame than the device does loses nothing for a while: the line holds what waits, and
it is only ever later. It is seen where a frame had long been on the line when the one before it was published. From
there to its own publishing the runtime had no other work, so that is what it takes for a frame::

    device      1     2     3     4     5     6             when each was due, by the device's clock
    on the line 1     2     3     4     5     6             by the host's clock
    published    1        2        3        4        5      3, 4 and 5 waited: their spacing is the runtime's own

What frames that waited took in all, less what the device took for as many, less the time in which the frame loop's
thread could have gone on and got no core (as the kernel counts), is how far it fell *behind*. Its *pace* is

    (published / measured) * span / (span + behind)

1 for who keeps up, however late a busy machine lets frames come; 0.83 for who takes 6 ms for what is measured every
5 ms. Time without a core is taken off as a whole, so beside a busy machine it may hide slowness, never feign it.
"""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

LEAST: Final = 0.95
"""What is demanded."""

WAITED_NS: Final = 20_000_000
"""A frame that was on the line for so long before the one before it was published did wait for the runtime."""

LOOK_NS: Final = 20_000_000
"""Between two looks at a process."""

ENOUGH: Final = 50
"""Frames of which a pace can be told."""


class Waits:
    """How long a process's first thread, in which the frame loop runs, could have gone on and got no core."""

    def __init__(self, process: int) -> None:
        self._schedstat = Path(f"/proc/{process}/task/{process}/schedstat")
        self._first_ns = self._last_ns = self._looked_ns = 0

    @property
    def total_ns(self) -> int:
        """Between the first look and the last."""
        return self._last_ns - self._first_ns

    def look(self, now_ns: int) -> None:
        """Look, unless that was just done.

        Args:
            now_ns: On the clock of all looks.
        """
        if now_ns - self._looked_ns < LOOK_NS:
            return
        with suppress(OSError):  # it has ended
            self._last_ns = int(self._schedstat.read_text().split()[1])
            if not self._looked_ns:
                self._first_ns = self._last_ns
            self._looked_ns = now_ns


@dataclass(frozen=True)
class Passed:
    """A frame that was published."""

    number: int
    """Of the runtime."""
    sequence: int
    """Of the device."""
    due_ns: int
    """When it was measured, by the device's clock."""
    wire_ns: int
    """When it went onto the line, by the host's clock."""
    published_ns: int
    """By the host's clock."""


def pace(frames: Iterable[Passed], waited_ns: int) -> float | None:
    """Return the pace of a stream; None of too few frames.

    Args:
        frames: Consecutive ones, as far as they were received.
        waited_ns: How long the runtime was without a core meanwhile (:class:`Waits`).
    """
    seen = list(frames)
    if len(seen) < ENOUGH:
        return None
    first, last = seen[0], seen[-1]
    late_ns = sum(
        b.published_ns - a.published_ns - (b.due_ns - a.due_ns)
        for a, b in pairwise(seen)
        if b.wire_ns + WAITED_NS < a.published_ns
    )
    span_ns = last.due_ns - first.due_ns
    behind_ns = max(0, late_ns - waited_ns)
    return (last.number - first.number) / (last.sequence - first.sequence) * span_ns / (span_ns + behind_ns)


def kept(found: float | None) -> bool:
    """Return whether there is a pace, and it is what is demanded."""
    return found is not None and found >= LEAST
