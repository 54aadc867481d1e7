"""A subscribing socket that is connected, and given back: what all subscriptions have in common."""

from collections.abc import Iterable
from types import TracebackType
from typing import Any, Final, Self

import zmq

from eitskin.errors import EndpointError
from eitskin.messaging.curve_keys import ClientKeys

LARGEST_TAKEN: Final = 73728
"""Bytes of a message that is still looked at; whoever sends a larger one is left: memory is bounded."""


class Subscriber:
    """A connected socket; leave it with ``close`` or as a context manager.

    Args:
        endpoint: ``ipc:///path`` or ``tcp://address:port``.
        topics: To subscribe to, in this order.
        queue: Messages that wait on this side at most.
        newest: Keep one message only, the newest; it does not go with more than one topic.
        keys: CURVE keys for TCP beyond loopback.

    Raises:
        EndpointError: ZeroMQ cannot make sense of the endpoint.
    """

    def __init__(
        self, endpoint: str, topics: Iterable[bytes], queue: int, *, newest: bool = False, keys: ClientKeys | None
    ) -> None:
        self.endpoint = endpoint
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
