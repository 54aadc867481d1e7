"""Comings without end: who connects, says so much and leaves, as often as one process can, many at a time."""

import os
import random
import select
import socket
import time
from contextlib import suppress

from .peer import GREETING, attempt, packed, ready

AT_ONCE = 64
"""Connections at a time."""

STAYS_S = 0.5
"""How long one waits to be let in before it leaves for another."""

GREETING_2 = b"\xff" + bytes(7) + b"\x01\x7f" + bytes([1, 2]) + packed(b"")
"""Of ZMTP 2.0: a revision, SUB, and an identity that is empty; no handshake follows."""


class Forms:
    """What who comes says first, and what once it is let in; None to be gone before.

    Args:
        rng: Draws the form of each coming.
        topics: That one asks for.
    """

    def __init__(self, rng: random.Random, topics: int = 100) -> None:
        self._rng = rng
        self._hello = GREETING + ready("SUB")
        self._many = b"".join(packed(b"\x01" + os.urandom(6) + bytes(40)) for _ in range(topics))
        self._tiny = b"".join(packed(b"\x01" + bytes([index % 256])) for index in range(2040))

    def draw(self) -> tuple[bytes, bytes | None]:
        """Return both for one coming; most ask when they are let in, the worst of all."""
        return self._rng.choice(
            (
                *[(self._hello, self._many)] * 8,
                (self._hello, self._tiny),
                (self._hello, None),
                (self._hello + self._many, None),
                (GREETING_2 + self._many, None),
            )
        )


class _Coming:
    """One connection."""

    def __init__(self, stream: socket.socket, first: bytes, then: bytes | None) -> None:
        self.stream, self._then, self._received = stream, then, b""
        self.until_s = time.monotonic() + STAYS_S
        stream.send(first)

    def over(self) -> bool:
        """Go on with what can be read; True once everything is said, or the other side has left."""
        if self._then is None:
            return True
        try:
            came = self.stream.recv(4096)
        except BlockingIOError:
            return False
        except OSError:
            return True
        self._received += came
        if b"READY" not in self._received:
            return not came
        with suppress(OSError):
            self.stream.send(self._then)
        return True


class Churn:
    """Comes, asks and leaves without end.

    Args:
        endpoint: Where.
        span_s: For how long.
        rng: Draws what is said.
        at_once: Connections at a time.
    """

    def __init__(self, endpoint: str, span_s: float, rng: random.Random, at_once: int = AT_ONCE) -> None:
        self.made = 0
        """Comings so far."""
        self._endpoint, self._span_s, self._at_once = endpoint, span_s, at_once
        self._forms = Forms(rng)
        self._here: dict[int, _Coming] = {}

    def run(self) -> None:
        """Begin, and return when it is over."""
        end_s = time.monotonic() + self._span_s
        with select.epoll() as poll:
            while time.monotonic() < end_s:
                while len(self._here) < self._at_once and self._come(poll):
                    pass
                able = {number for number, _ in poll.poll(0.002)}
                now_s = time.monotonic()
                for number, coming in list(self._here.items()):
                    if (number in able and coming.over()) or now_s > coming.until_s:
                        del self._here[number]
                        coming.stream.close()
        for coming in self._here.values():
            coming.stream.close()

    def _come(self, poll: select.epoll) -> bool:
        """Come once; False if too many wait already."""
        stream = attempt(self._endpoint)
        if stream is None:
            return False
        self.made += 1
        first, then = self._forms.draw()
        try:
            coming = _Coming(stream, first, then)
        except OSError:
            stream.close()
            return True
        if then is None:
            stream.close()
        else:
            self._here[stream.fileno()] = coming
            poll.register(stream, select.EPOLLIN)
        return True
