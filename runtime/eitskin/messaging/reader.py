"""Iterates over what comes: one thread reads, any other may stop or close at the same time.

A socket belongs to the thread that uses it. So ``close`` gives it back at once only if no thread reads. Otherwise the
reading thread gives it back, at most ``LONGEST_WAIT_MS`` later. No call waits for another thread.
"""

import threading
from typing import Final, Generic, NoReturn, Self, TypeVar

from eitskin.errors import Closed

LONGEST_WAIT_MS: Final = 100
"""How long a reading thread waits before it looks whether it was stopped."""

Item = TypeVar("Item")
"""The items of a subscription."""


class Reader(Generic[Item]):
    """The base of all subscriptions; it knows nothing of sockets.

    A subclass waits for an item (:meth:`_wait`), and gives its sockets back (:meth:`_release`).
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        """Held by the thread that uses the socket."""
        self._stopped = self._closing = False

    def _wait(self, timeout_s: float | None) -> Item:
        """Return the next item; call :meth:`_check_stopped` every ``LONGEST_WAIT_MS``."""
        raise NotImplementedError

    def _release(self) -> None:
        """Give the sockets back; a second call does nothing."""
        raise NotImplementedError

    def _check_stopped(self) -> None:
        if self._stopped:
            raise Closed("the subscription was stopped or closed; subscribe again for more")

    def _next(self, timeout_s: float | None = None) -> Item:
        """Return the next item, waiting for it.

        Raises:
            Closed: The subscription was stopped or closed.
        """
        try:
            with self._lock:
                self._check_stopped()
                return self._wait(timeout_s)
        finally:
            if self._closing:
                self.close()

    def __next__(self) -> Item:
        try:
            return self._next()
        except Closed:
            raise StopIteration from None

    def __iter__(self) -> Self:
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __reduce__(self) -> NoReturn:
        name = type(self).__name__
        raise TypeError(f"a {name} is a connection of this process and cannot be pickled; subscribe in the other one")

    def stop(self) -> None:
        """End iteration within 0.1 s, from any thread or a signal handler; a waiting call raises ``eitskin.Closed``."""
        self._stopped = True

    def close(self) -> None:
        """Stop, and give the socket back, from any thread; a second call does nothing.

        If another thread reads, it gives the socket back within 0.1 s.
        """
        self._stopped = self._closing = True
        if self._lock.acquire(blocking=False):
            try:
                self._release()
            finally:
                self._lock.release()
