"""A ZMTP 3.0 publisher over ipc that says what it is told to each who comes: no libzmq, nothing of eitskin."""

import socket
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress

from .peer import GREETING, packed, ready

FRAMES = (b"\xde\x00",)
"""Topics of who takes every frame with its map: the two bytes with which each begins."""


class Host:
    """Serves one subscriber after the other in a thread; release it with ``close``.

    Args:
        path: Where it listens.
        serve: Called with each connection, greeted and subscribed to; what it does not close is closed.
        greeting: What is said first to the first who comes.
        topics: All that is subscribed to before who came is served, in any order.
    """

    def __init__(
        self,
        path: str,
        serve: Callable[[socket.socket], None],
        greeting: bytes = GREETING,
        topics: Iterable[bytes] = FRAMES,
    ) -> None:
        self._serve, self._greeting = serve, greeting
        self._subscriptions = [packed(b"\x01" + topic) for topic in topics]
        self.served = 0
        """Who came so far."""
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(path)
        self._listener.listen()
        self._thread = threading.Thread(target=self._accept)
        self._thread.start()

    def _accept(self) -> None:
        while True:
            try:
                stream, _ = self._listener.accept()
            except OSError:
                return
            greeting = GREETING if self.served else self._greeting
            self.served += 1
            with stream, suppress(OSError):
                stream.settimeout(10)
                stream.sendall(greeting)
                received = b""
                while len(received) < len(GREETING) + 10:
                    if not (data := stream.recv(4096)):
                        break
                    received += data
                stream.sendall(ready("PUB"))
                while not all(one in received[len(GREETING) :] for one in self._subscriptions):
                    if not (data := stream.recv(4096)):
                        break
                    received += data
                self._serve(stream)

    def close(self) -> None:
        """Listen no more; ends once the last subscriber has left."""
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()
