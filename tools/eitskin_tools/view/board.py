"""The newest message of each kind and skin, and the threads that wait for a newer one.

A page takes newer messages as fast as it can, never more than one of each kind and skin: a page that stalls delays
nobody and takes no memory.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

KINDS: Final = ("skin", "overview", "surface", "frame", "state", "status")
"""In the order in which a page receives them."""

MAX_PAGES: Final = 16
"""Open at the same time."""


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
        """Open pages."""
        return self._pages

    @property
    def closed(self) -> bool:
        """Whether nothing will be posted any more."""
        return self._closed

    def post(self, kind: str, message: bytes, of: int = 0) -> None:
        """Replace the message of its kind and skin.

        Args:
            kind: One of ``KINDS``.
            message: Made by :mod:`eitskin_tools.view.messages`.
            of: Number of the skin.
        """
        with self._changed:
            self._posts += 1
            self._newest[kind, of] = (self._posts, message)
            self._changed.notify_all()

    @contextmanager
    def page(self) -> Iterator[bool]:
        """Count a page while it is open; give False if too many are open."""
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
        """Return what was posted after a number, and the number for the next call; nothing after a timeout.

        Args:
            than: Number from the previous call; 0 at first.
            timeout_s: How long to wait.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._posts > than, timeout_s)
            found = [(KINDS.index(kind), of, text) for (kind, of), (n, text) in self._newest.items() if n > than]
            return self._posts, [text for _, _, text in sorted(found)]

    def wait_for_pages(self, timeout_s: float) -> bool:
        """Wait until a page is open; return whether one is."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._pages > 0, timeout_s)
            return self._pages > 0

    def close(self) -> None:
        """Wake all waiting threads; nothing is posted any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
