"""Publishes frames: one part a message, to whoever subscribed, waiting for nobody.

The socket is an XPUB: it tells who subscribes, so that a frame nobody wants costs no inference. Every subscriber has a
bounded queue; a slow one loses frames there, and neither the loop nor its neighbours notice.

Subscribers are not trusted. All that they can send is subscriptions, which libzmq keeps in memory for them: messages
are limited to a few bytes, and a socket that has collected more topics, messages or connections than any honest crowd
would need is closed and opened again. Honest subscribers come back by themselves within a tenth of a second.
"""

from typing import Any, Final

import zmq

from eitskin.curve import Doorkeeper, ServerKeys
from eitskin.endpoints import bind, release, reopen
from eitskin.errors import EndpointError
from eitskin.guard import Connections

QUEUE_FRAMES: Final = 400
"""Frames that wait for one subscriber at most: 2 s at 200 frames/s, 2.4 MB."""

LARGEST_SUBSCRIPTION: Final = 512
"""Bytes; a subscription to everything has 1, but CURVE's handshake, which counts as well, has up to 260."""

MOST_TOPICS: Final = 32
"""Topics that may be subscribed to at once; frames have one, the empty one."""

MOST_AT_ONCE: Final = 256
"""Subscription messages that may arrive between two frames."""

MOST_CONNECTIONS: Final = 128
"""Subscribers at once; see :mod:`eitskin.guard`."""


class Publisher:
    """A bound publishing socket; release it with ``close``.

    Args:
        endpoint: ``ipc:///path`` or ``tcp://address:port``.
        keys: CURVE keys, needed for TCP beyond loopback.

    Raises:
        EndpointError: The endpoint is not allowed like this, or in use.
    """

    def __init__(self, endpoint: str, keys: ServerKeys | None = None) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._keys = keys
        self.resets = 0
        """How often a flood made the socket start anew."""
        self.dropped = 0
        """Frames that the socket did not take."""
        self._topics = 0
        self._doorkeeper = Doorkeeper(self._context, keys) if keys is not None else None
        self.endpoint = ""
        """Where frames are published, with the port that a ``*`` became."""
        try:
            self._open(endpoint)
        except BaseException:
            self.close()
            raise

    def _open(self, endpoint: str) -> None:
        self._socket: Any = self._context.socket(zmq.XPUB)
        self._socket.setsockopt(zmq.SNDHWM, QUEUE_FRAMES)
        self._socket.setsockopt(zmq.RCVHWM, MOST_AT_ONCE)
        self._socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_SUBSCRIPTION)
        self._socket.setsockopt(zmq.HANDSHAKE_IVL, 2000)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._connections = Connections(self._socket)
        self._topics = 0
        try:
            self.endpoint = bind(self._socket, endpoint, keys=self._keys, control=False)
        except EndpointError:
            self._close_socket()
            raise

    @property
    def wanted(self) -> bool:
        """Whether anybody subscribes, as of the last ``look``."""
        return self._topics > 0

    def look(self) -> None:
        """Take note of who came and went since the last time; never waits."""
        seen = 0
        while self._socket.getsockopt(zmq.EVENTS) & zmq.POLLIN:
            message = self._socket.recv(zmq.NOBLOCK)
            seen += 1
            if message[:1] == b"\x01":
                self._topics += 1
            elif message[:1] == b"\x00":
                self._topics -= 1
            if self._topics > MOST_TOPICS or seen > MOST_AT_ONCE:
                self._start_anew()
                return

    def look_at_connections(self) -> None:
        """Count connections; cheap enough for a few times a second, not for each frame."""
        if self._connections.look() > MOST_CONNECTIONS:
            self._start_anew()

    def send(self, message: memoryview) -> None:
        """Hand one message to every subscriber's queue; the memory may be reused at once."""
        try:
            self._socket.send(message, zmq.NOBLOCK, copy=True)
        except zmq.Again:
            self.dropped += 1

    def _start_anew(self) -> None:
        self._close_socket()
        self.resets += 1
        reopen(self._open, self.endpoint)

    def _close_socket(self) -> None:
        self._connections.close()
        self._socket.close(0)

    def close(self) -> None:
        """Release the address; closing twice is fine."""
        if self._context.closed:
            return
        self._close_socket()
        self._context.term()
        if self._doorkeeper is not None:
            self._doorkeeper.join()
        release(self.endpoint)
