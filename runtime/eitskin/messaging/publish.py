r"""Publishes frames: one part a message, to whoever subscribed, waiting for nobody.

The socket is an XPUB: it tells who subscribes, so that a frame nobody wants costs no inference. Every subscriber has a
bounded queue; a slow one loses frames there, and neither the loop nor its neighbours notice.

Topics say what a subscriber needs. The empty one, which any program in any language may use, gets every frame with its
whole map. A subscriber that subscribes to the first byte of a frame instead declares by topics of its own that it needs
a region only (:mod:`eitskin.messaging.regions`), or that it does without a map that has not changed. ::

    b""                            everything, always
    b"\xde"                        every frame, and then one of each:
    b"eitskin/region/0/30/0/45"    the rows and columns that are needed
    b"eitskin/unchanged"           ... or b"eitskin/always"

Subscribers are not trusted. All that they can send is subscriptions, which libzmq keeps in memory for them: messages
are limited to a few bytes, and a socket that has collected more topics, messages or connections than any honest crowd
would need is closed and opened again. Honest subscribers come back by themselves within a tenth of a second.
"""

from typing import Any, Final

import zmq

from eitskin.errors import EndpointError
from eitskin.messaging.connection_limit import Connections
from eitskin.messaging.curve_keys import Doorkeeper, ServerKeys
from eitskin.messaging.endpoints import bind, release, reopen
from eitskin.messaging.frame import FIRST_BYTE
from eitskin.messaging.regions import ALWAYS, UNCHANGED, WHOLE, Region, Regions, union

QUEUE_FRAMES: Final = 400
"""Frames that wait for one subscriber at most: 2 s at 200 frames/s, 2.4 MB."""

LARGEST_SUBSCRIPTION: Final = 512
"""Bytes; a subscription to everything has 1, but CURVE's handshake, which counts as well, has up to 260."""

MOST_TOPICS: Final = 400
"""Subscriptions at once, of all subscribers; each has one or three."""

MOST_AT_ONCE: Final = 512
"""Subscription messages that may arrive between two looks."""

_EVENTS, _POLLIN, _NOBLOCK = zmq.EVENTS, int(zmq.POLLIN), int(zmq.NOBLOCK)  # an enumeration's & takes microseconds

MOST_CONNECTIONS: Final = 128
"""Subscribers at once; see :mod:`eitskin.messaging.connection_limit`."""


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
        self._topics: dict[bytes, int] = {}
        self._doorkeeper = Doorkeeper(self._context, keys) if keys is not None else None
        self.wanted = False
        """Whether anybody subscribes, as of the last ``look``."""
        self.regions: Regions = (WHOLE,)
        """What of the map all subscribers together need."""
        self.takes_short = False
        """Whether every subscriber does without a map that has not changed."""
        self.joined = True
        """Somebody came or went since the last frame was sent: the next one must carry its map."""
        self.endpoint = ""
        """Where frames are published, with the port that a ``*`` became."""
        try:
            self._open(endpoint)
        except BaseException:
            self.close()
            raise

    def _open(self, endpoint: str) -> None:
        self._socket: Any = self._context.socket(zmq.XPUB)
        self._send = super(zmq.Socket, self._socket).send  # without the wrapper, which is for other kinds of sockets
        self._socket.setsockopt(zmq.SNDHWM, QUEUE_FRAMES)
        self._socket.setsockopt(zmq.RCVHWM, MOST_AT_ONCE)
        self._socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_SUBSCRIPTION)
        self._socket.setsockopt(zmq.HANDSHAKE_IVL, 2000)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.XPUB_VERBOSER, 1)  # every subscriber by itself, not the first and the last of many
        self._connections = Connections(self._socket)
        self._topics = {}
        self._judge()
        try:
            self.endpoint = bind(self._socket, endpoint, keys=self._keys, control=False)
        except EndpointError:
            self._close_socket()
            raise

    def look(self) -> None:
        """Take note of who came and went since the last time; never waits."""
        seen = 0
        while self._socket.getsockopt(_EVENTS) & _POLLIN:
            message = self._socket.recv(_NOBLOCK)
            seen += 1
            topic, joins = message[1:], message[:1] == b"\x01"
            if joins or message[:1] == b"\x00":
                self._count(topic, joins)
            if sum(self._topics.values()) > MOST_TOPICS or seen > MOST_AT_ONCE:
                self._start_anew()
                return
        if seen:
            self._judge()

    def _count(self, topic: bytes, joins: bool) -> None:
        count = self._topics.get(topic, 0) + (1 if joins else -1)
        if count > 0:
            self._topics[topic] = count
        else:
            self._topics.pop(topic, None)

    def _judge(self) -> None:
        """Make of the topics what the loop must know."""
        topics = self._topics
        plain = any(topic == b"" or (topic[:1] == FIRST_BYTE and topic != FIRST_BYTE) for topic in topics)
        declared = [region for topic in topics if (region := Region.from_topic(topic)) is not None]
        self.wanted = plain or FIRST_BYTE in topics
        self.regions = (WHOLE,) if plain else union(declared)
        self.takes_short = UNCHANGED in topics and ALWAYS not in topics and not plain
        self.joined = True

    def look_at_connections(self) -> None:
        """Count connections; cheap enough for a few times a second, not for each frame."""
        if self._connections.look() > MOST_CONNECTIONS:
            self._start_anew()

    @property
    def short(self) -> bool:
        """Whether the next message may go without a map that has not changed."""
        return self.takes_short and not self.joined

    def send(self, message: memoryview) -> None:
        """Hand one message to every subscriber's queue; the memory may be reused at once."""
        try:
            self._send(message, _NOBLOCK, True)
        except zmq.Again:
            self.dropped += 1
        self.joined = False

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
