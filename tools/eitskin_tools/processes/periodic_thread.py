"""A thread that checks something at intervals, so that what is checked never waits."""

import threading
from typing import Self


class PeriodicThread:
    """Checks from when it is entered to when it is left.

    Args:
        name: The thread's.
        every_s: Between two checks.
        leave_s: How long leaving waits for the last check; None for as long as it takes.
    """

    def __init__(self, name: str, every_s: float, leave_s: float | None = None) -> None:
        self._every_s, self._leave_s = every_s, leave_s
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def check(self) -> None:
        """Check once."""
        raise NotImplementedError

    def _run(self) -> None:
        while not self._left.wait(self._every_s):
            self.check()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._left.set()
        self._thread.join(self._leave_s)
