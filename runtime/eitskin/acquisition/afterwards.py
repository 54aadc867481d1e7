"""What is left to do of a frame that has gone out: done while the line rests, and always before the next frame.

Whoever takes frames is woken by the frame's message, and needs a core at that moment; on two cores this process would
be in its way. So it waits for the line a moment first. Bytes that come end the moment: no frame waits for it.
"""

import time
from collections.abc import Callable
from typing import Any, Final

from eitskin.acquisition.device import Device

GIVE_WAY_S: Final = 0.001
"""The least that ports wait, which count in milliseconds; several times what a subscriber takes to have its frame
(``deliver`` of ``tools/studies/recording.py``)."""


class Afterwards:
    """Keeps what is left to do of one frame.

    Args:
        done: Told when it began and when it ended, on ``perf_counter_ns``; None if nobody wants to know.
    """

    __slots__ = ("_arguments", "_done", "_then", "_work")

    def __init__(self, done: Callable[[int, int], None] | None) -> None:
        self._done = done
        self._work: Callable[..., None] | None = None
        self._then: Callable[[], None] | None = None
        self._arguments: tuple[Any, ...] = ()

    def put(self, then: Callable[[], None], work: Callable[..., None], *arguments: Any) -> None:
        """Keep something to do; what was kept before has been done.

        Args:
            then: What must not be done before it.
            work: What is left, and timed.
            arguments: Of it.
        """
        self._then, self._work, self._arguments = then, work, arguments

    def do(self) -> None:
        """Do what is kept, now."""
        work, self._work = self._work, None
        if work is not None:
            begin_ns = time.perf_counter_ns()
            work(*self._arguments)
            if self._done is not None:
                self._done(begin_ns, time.perf_counter_ns())
            if self._then is not None:
                self._then()

    def payloads(self, device: Device) -> list[bytes]:
        """Return what came meanwhile: wait for the line a moment, and do what is kept. At once if nothing is.

        Raises:
            PortLost: The line is gone.
        """
        if self._work is None:
            return []
        try:
            return device.payloads(GIVE_WAY_S)
        finally:
            self.do()
