"""What pages are to show now: the newest message of each kind and skin, and the threads that wait for a newer one.

A page takes what is newer than what it has, as fast as it can, and never more than one message of a kind of a skin: one
that stalls makes nobody wait and keeps no memory.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

KINDS: Final = ("skin", "overview", "surface", "frame", "state", "status")
"""In the order in which a page takes them."""

MAX_PAGES: Final = 16
"""At once."""


class Board:
    """The newest messages, for any number of threads."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._newest: dict[tuple[str, int], tuple[int, bytes]] = {}
        self._posts = 0
        self._pages = 0
        self._closed = False

    @property
    def pages(self) -> int:
        """Pages that look on."""
        return self._pages

    @property
    def closed(self) -> bool:
        """Whether nothing will be posted any more."""
        return self._closed

    def post(self, kind: str, message: bytes, of: int = 0) -> None:
        """Put a message in the place of the one before of its kind and its skin.

        Args:
            kind: One of ``KINDS``.
            message: What :mod:`eitskin_tools.view.messages` made.
            of: Which of the skins.
        """
        with self._changed:
            self._posts += 1
            self._newest[kind, of] = (self._posts, message)
            self._changed.notify_all()

    @contextmanager
    def page(self) -> Iterator[bool]:
        """Count a page for as long as it looks on; give False where there are enough already."""
        with self._changed:
            room = self._pages < MAX_PAGES and not self._closed
            self._pages += room
            self._changed.notify_all()
        try:
            yield room
        finally:
            with self._changed:
                self._pages -= room
                self._changed.notify_all()

    def newer(self, than: int, timeout_s: float) -> tuple[int, list[bytes]]:
        """Return what was posted after a number, and the number to ask with next; nothing if nothing was in time.

        Args:
            than: What the call before returned; 0 at first.
            timeout_s: How long to wait.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._posts > than, timeout_s)
            found = [(KINDS.index(kind), of, text) for (kind, of), (n, text) in self._newest.items() if n > than]
            return self._posts, [text for _, _, text in sorted(found)]

    def wait_for_pages(self, timeout_s: float) -> bool:
        """Wait until somebody looks on; return whether somebody does."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._pages > 0, timeout_s)
            return self._pages > 0

    def close(self) -> None:
        """Send everybody home."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
