"""Looks at a TCP address while the loop that looks otherwise stands still: no frame comes, the device is greeted anew.

libzmq accepts whoever comes there at any time. Without this a crowd would take all descriptors meanwhile, and the port
of a device that comes back could not be opened.
"""

import threading
from collections.abc import Callable
from typing import Final

PATROL_S: Final = 0.5
"""Without a look for so long, this one looks, and again as often."""


class Patrol:
    """A thread that sleeps while others look; leave it with ``close``.

    Args:
        look: What to do, under ``lock``; takes no more than a moment.
    """

    def __init__(self, look: Callable[[], None]) -> None:
        self.lock = threading.Lock()
        """Held by whoever looks."""
        self.seen = False
        """Somebody looked since this was last set to False."""
        self._look = look
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._walk, name="eitskin-patrol", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def _walk(self) -> None:
        while not self._over.wait(PATROL_S):
            if self.seen:
                self.seen = False
                continue
            with self.lock:
                self._look()

    def close(self) -> None:
        """End it; fine if it never began."""
        self._over.set()
        if self._thread.ident is not None:
            self._thread.join()
