"""Lets newcomers at a TCP address without keys in, a few at a time, and only while the loop keeps up with them.

libzmq accepts whoever comes. For each it makes pipes of 40 kB and sends commands to the socket's owner, the frame loop,
which takes in all that wait at once: thousands of comings a second stop it for seconds. But first libzmq asks whether
somebody may enter (ZAP, RFC 27), and until it has an answer none of that exists: no pipe, no subscription, no command.
So here they wait, in libzmq's I/O thread and in this one. ::

    who comes -> greeting -> question -> waits here ........................ -> answer -> pipes, subscriptions, the loop
                                            as many as looks have made room for

A look that found little to do makes room for a few. Whoever left while waiting costs no more than his turn.
"""

import os
import threading
from collections import deque
from contextlib import suppress
from typing import Any, Final

import zmq

DOMAIN: Final = "eitskin-open"
"""What a socket without keys calls itself when it asks who may enter."""

FIRST: Final = 32
"""Newcomers that come in at once after a quiet moment."""

BATCH: Final = 8
"""Newcomers for whom a calm look makes room: 800 a second."""

WAITING: Final = 128
"""Newcomers that wait; beyond it the one who waits longest is forgotten, and has to come anew after 2 s."""


class Turnstile:
    """A thread that answers libzmq's questions; it ends when the context is terminated, see :meth:`join`.

    Args:
        context: The ZeroMQ context whose sockets it guards.
    """

    def __init__(self, context: Any) -> None:
        self._calm = 0
        """Calm looks so far; written by who looks alone."""
        self._wanting = False
        """Somebody waits, and there is no room; written by the thread alone."""
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._questions = context.socket(zmq.ROUTER)
        self._questions.setsockopt(zmq.LINGER, 0)
        self._questions.bind("inproc://zeromq.zap.01")
        self._thread = threading.Thread(target=self._serve, name="eitskin-turnstile", daemon=True)
        self._thread.start()

    @staticmethod
    def apply(socket: Any) -> None:
        """Make a ZeroMQ socket ask; before it is bound."""
        socket.setsockopt(zmq.ZAP_DOMAIN, DOMAIN.encode())

    def calm(self) -> None:
        """Take note of a look that found little to do; from one thread at a time, and in a microsecond."""
        self._calm += 1
        if self._wanting:
            os.eventfd_write(self._wake, 1)

    def _serve(self) -> None:
        waiting: deque[list[bytes]] = deque(maxlen=WAITING)
        room, seen = FIRST, self._calm
        poller = zmq.Poller()
        poller.register(self._questions, zmq.POLLIN)
        poller.register(self._wake, zmq.POLLIN)
        with suppress(zmq.ContextTerminated):
            while True:
                poller.poll()
                with suppress(BlockingIOError):
                    os.eventfd_read(self._wake)
                self._take(waiting)
                self._wanting = len(waiting) > room  # before the looks are counted: one that comes now wakes it again
                calm = self._calm
                room, seen = min(FIRST, room + BATCH * (calm - seen)), calm
                while waiting and room:
                    self._admit(waiting.pop())  # who came last is the likeliest to be there still
                    room -= 1
        self._questions.close()

    def _take(self, waiting: deque[list[bytes]]) -> None:
        """Take in all questions, so that libzmq keeps none of those who have left."""
        with suppress(zmq.Again):
            while True:
                waiting.append(self._questions.recv_multipart(zmq.NOBLOCK))

    def _admit(self, question: list[bytes]) -> None:
        """Answer yes; dropped if who asked has left."""
        route, _, version, number, *_ = question
        self._questions.send_multipart([route, b"", version, number, b"200", b"OK", b"", b""], zmq.NOBLOCK)

    def join(self) -> None:
        """Wait for the thread, after the context was terminated."""
        self._thread.join()
        os.close(self._wake)
