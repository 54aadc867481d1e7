"""A subscribing socket that is connected, connected anew, and given back: what all subscriptions have in common.

libzmq connects again by itself when the other side ended a connection, but never when it ended one itself: after a
message beyond all bounds, or something that is no ZMTP, such as another program on the port. So whoever waits looks
after its connection: nobody waits longer than ``LONGEST_WAIT_MS`` at a time.
"""

import math
import os
import stat
import time
from collections.abc import Iterable
from contextlib import suppress
from types import TracebackType
from typing import Any, Final, Self

import zmq

from eitskin.errors import EndpointError, FrameError
from eitskin.messaging.curve_keys import ClientKeys
from eitskin.messaging.endpoints import check_client_keys
from eitskin.messaging.reachability import explain_silence

Connection = tuple[int, int]
"""A connection as long as it lives: its descriptor and its inode. A number that is used again has another inode."""

_POLLIN: Final = int(zmq.POLLIN)

LARGEST_TAKEN: Final = 73728
"""Bytes of a message that is still looked at; whoever sends a larger one is left: memory is bounded."""

PATIENCE_S: Final = 1.0
"""Silence after which it is looked whether the connection still lives; twice as long each time that did not help."""

MOST_PATIENCE_S: Final = 16.0
LONGEST_WAIT_MS: Final = 1000
"""How long the socket waits at a time."""


class Subscriber:
    """A connected socket; leave it with ``close`` or as a context manager.

    Args:
        endpoint: ``ipc:///path`` or ``tcp://address:port``.
        topics: To subscribe to, in this order.
        queue: Messages that wait on this side at most.
        newest: Keep one message only, the newest; it does not go with more than one topic.
        keys: CURVE keys, which TCP needs.

    Raises:
        EndpointError: ZeroMQ cannot make sense of the endpoint, or it is TCP and there are no keys.
    """

    def __init__(
        self, endpoint: str, topics: Iterable[bytes], queue: int, *, newest: bool = False, keys: ClientKeys | None
    ) -> None:
        check_client_keys(endpoint, keys)
        self.endpoint = endpoint
        self.reconnected = 0
        """How often the connection was made anew because it was gone, or nothing had ever come over it."""
        self.rejected = 0
        """Messages that were not what was subscribed to, or were damaged."""
        self._unusable: tuple[int, str] = (0, "")
        """Messages that were rejected since the last one that was taken, and what the last of them was."""
        self._connection: Connection | None = None
        """Over which the last message came, as far as it is known; looked at anew after silence."""
        self._patience_s = PATIENCE_S
        self._heard_ns = time.perf_counter_ns()
        """When the last message came."""
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket: Any = self._context.socket(zmq.SUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_TAKEN)
        self._socket.setsockopt(zmq.RCVHWM, queue)
        if newest:
            self._socket.setsockopt(zmq.CONFLATE, 1)
        if keys is not None:
            keys.apply(self._socket)
        # Before it connects: CONFLATE holds for what is sent as well, and a subscription that is written in the instant
        # in which libzmq's own thread looks for one is lost without a word (dbuffer.hpp): 4 of 300,000.
        for topic in topics:
            self._socket.setsockopt(zmq.SUBSCRIBE, topic)
        try:
            self._socket.connect(endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise EndpointError(
                f"{endpoint!r} cannot be connected to: {error.strerror}; expected ipc:///path or tcp://address:port"
            ) from error

    @property
    def waits(self) -> bool:
        """Whether a message is there already."""
        return bool(self._socket.getsockopt(zmq.EVENTS) & _POLLIN)

    def _comes(self, end_s: float) -> bool:
        """Wait for a message until ``time.perf_counter()`` shows ``end_s``; return whether one waits."""
        while True:
            left_ms = max(0.0, 1000 * (end_s - time.perf_counter()))
            if self._socket.poll(math.ceil(min(left_ms, LONGEST_WAIT_MS))):
                return True
            self._look_at_connection()
            if left_ms <= LONGEST_WAIT_MS:
                return False

    def _reject(self, error: FrameError) -> None:
        """Count a message that cannot be used; whoever publishes there, it must not end a robot's loop."""
        self.rejected += 1
        self._unusable = self._unusable[0] + 1, str(error)

    def silence(self, waited_s: float, what: str = "frame", likely: str = "") -> str:
        """Return why nothing that was waited for came; arguments as of :func:`explain_silence`."""
        (count, last), self._unusable = self._unusable, (0, "")
        if count:
            return f"what comes ({count} in that time) is no {what} that can be used: {last}"
        return explain_silence(self.endpoint, waited_s, what, likely)

    def _recv(self) -> bytes:
        """Receive a message, and keep in mind when it came, and over which connection."""
        message: bytes = self._socket.recv() if self._connection is not None else self._recv_first()
        self._heard_ns = time.perf_counter_ns()
        return message

    def _recv_first(self) -> bytes:
        message = self._socket.recv(copy=False)
        with suppress(zmq.ZMQError):  # libzmq does not know
            self._connection = connection_at(message.get(zmq.SRCFD))
        self._patience_s = PATIENCE_S
        return bytes(message.bytes)

    def _look_at_connection(self) -> None:
        """Connect anew if nothing has come for a while, and the connection was lost for good."""
        if time.perf_counter_ns() - self._heard_ns < self._patience_s * 1e9:
            return
        if self._connection is not None and connection_at(self._connection[0]) == self._connection:
            return
        with suppress(zmq.ZMQError):
            self._socket.disconnect(self.endpoint)
        self._socket.connect(self.endpoint)
        self.reconnected += 1
        self._connection = None
        self._heard_ns = time.perf_counter_ns()
        self._patience_s = min(2 * self._patience_s, MOST_PATIENCE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the socket back; closing twice is fine."""
        self._socket.close(0)
        self._context.term()


def connection_at(descriptor: int) -> Connection | None:
    """Return which socket lies at a descriptor now; None if there is none."""
    try:
        found = os.fstat(descriptor)
    except OSError:
        return None
    return (descriptor, found.st_ino) if stat.S_ISSOCK(found.st_mode) else None
