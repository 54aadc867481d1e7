r"""Publishes frames: one part a message, to all subscribers, without waiting for any.

The socket is an XPUB, which reports subscriptions, so that a frame without subscribers costs no inference. Every
subscriber has a bounded queue; a slow one loses frames there, and neither the loop nor its neighbours notice.

Topics say what a subscriber needs. A topic of the first two bytes of a frame selects every frame with its whole map.
The empty topic does too, and also selects everything that others ask for. A subscriber to the first byte alone declares
by further topics whether it needs unchanged maps (:mod:`eitskin.messaging.regions`). So does a patient one, with topics
of three bytes: libzmq hands a message to the shortest topic first, so robots, whose topics are shorter, do not wait for
it. ::

    b"\xde\x00"                    every frame with its map, always
    b""                            all that is sent
    b"\xde"                        every frame, and then one of each:
    b"\xde\x00\x18"                ... likewise, after the others; and so on to b"\xde\x00\x23"
    b"eitskin/region/..."          nothing: earlier releases computed only a part of the map
    b"eitskin/unchanged"           ... or b"eitskin/always"
    b"eitskin/touches"             also: the list of touches, in every frame
    b"\xdf"                        touches without maps, alone
    b"\x86\xa4wire"                measurements (:mod:`eitskin.messaging.streams.envelope` has the list)
    b"\x8f\xa8verified"            verdicts of the verifier (:mod:`eitskin.messaging.streams.verified`)

Subscribers with the empty topic get touch messages and streams too, and ignore them by their version. Touch messages
are sent before the frame, and streams after it.

A subscriber cannot take a topic away from others: a topic stays in use until libzmq itself reports that its last
subscriber has left. The publisher ignores unsubscriptions that a subscriber sends, because they may name a topic that
only others have.
"""

import time
from typing import Any, Final

import zmq

from eitskin.messaging.curve_keys import CurveAuthenticator, ServerKeys
from eitskin.messaging.frame import FIRST_BYTE, TOUCH_FIRST_BYTE, patient_topics
from eitskin.messaging.frame_message import Demand
from eitskin.messaging.listener import Listener, check_files, sender_of
from eitskin.messaging.regions import ALWAYS, TOUCHES, UNCHANGED
from eitskin.messaging.streams.publisher import StreamPublisher
from eitskin.messaging.streams.verified import asked_for

QUEUE_FRAMES: Final = 400
"""Frames that may wait for one subscriber, and none is lost: 2 s at 200 frames/s."""

MOST_WAITING: Final = 2 * QUEUE_FRAMES
"""High-water mark for libzmq, 4.8 MB. A subscriber acknowledges messages only at every half of it, and libzmq counts
the rest as waiting: just before an acknowledgement only half the room is left (libzmq 4.3.5)."""

LARGEST_SUBSCRIPTION: Final = 512
"""Bytes; a subscription to everything has 1, but CURVE's handshake, which counts as well, has up to 260."""

QUEUE_SUBSCRIPTIONS: Final = 2
"""Subscription messages of one connection that wait within libzmq, which reads until none waits. With 1, CURVE's
handshake does not end (libzmq 4.3.5)."""

MOST_AT_ONCE: Final = 256
"""Subscription messages that are taken in one update; a crowd of 128 that comes at once has 400, for two."""

MOST_TOPICS: Final = 512
"""Topics that are remembered; beyond this everything counts as requested."""

MOST_SUBSCRIBERS: Final = 128
"""Subscribers at once; further connections are ended."""

_EVENTS, _POLLIN, _NOBLOCK = zmq.EVENTS, int(zmq.POLLIN), int(zmq.NOBLOCK)  # an enumeration's & takes microseconds

DESERTED_S: Final = 2.0
"""Time without any connection after which all topics are forgotten."""

DECLARING: Final = frozenset((FIRST_BYTE, *patient_topics(FIRST_BYTE)))
"""Topics of frames for subscribers that declare their needs by further topics."""


class Publisher:
    """A bound publishing socket; release it with ``close``.

    Args:
        endpoint: ``ipc:///path`` or ``tcp://address:port``.
        keys: CURVE keys, required for TCP.

    Raises:
        EndpointError: The endpoint is not allowed or in use, or the process may open too few files.
    """

    def __init__(self, endpoint: str, keys: ServerKeys | None = None) -> None:
        check_files(endpoint)
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.dropped = 0
        """Frames that the socket did not take."""
        self._authenticator = CurveAuthenticator(self._context, keys) if keys is not None else None
        self.wanted = False
        """Whether there is a subscriber, as of the last ``update``."""
        self.asked = Demand()
        """What is requested in addition."""
        self.verified = False
        """Whether verified messages have a subscriber."""
        self.takes_short = False
        """Whether no subscriber needs unchanged maps."""
        self.joined = True
        """A subscriber came or went since the last frame: the next one must carry its map."""
        self.streams = StreamPublisher(self.send_beside)
        """The streams of measurements."""
        self._topics: set[bytes] = set()
        self._asked_s = 0.0
        """Time of the last subscription."""
        self._socket: Any = self._context.socket(zmq.XPUB)
        self._send = super(zmq.Socket, self._socket).send  # without the wrapper, which is for other kinds of sockets
        self._socket.setsockopt(zmq.SNDHWM, MOST_WAITING)
        self._socket.setsockopt(zmq.RCVHWM, QUEUE_SUBSCRIPTIONS)
        self._socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_SUBSCRIPTION)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.XPUB_VERBOSE, 1)  # every subscriber by itself, not the first of many
        try:
            self._listener = Listener(self._context, self._socket, endpoint, keys=keys, most=MOST_SUBSCRIBERS)
        except BaseException:
            self._end()
            raise
        self.endpoint = self._listener.endpoint
        """Where frames are published, with the port that a ``*`` became."""

    def update(self) -> None:
        """Note new and closed subscriptions, without waiting."""
        self._listener.admit()
        changed, left = False, MOST_AT_ONCE
        waits = self._socket.getsockopt(_EVENTS) & _POLLIN  # libzmq takes in more whenever it is asked
        while waits and left:
            try:
                message = self._socket.recv(_NOBLOCK, copy=False)
            except zmq.Again:
                break
            left -= 1
            changed |= self._receive(message)
        if self._topics and not self._listener.connections and time.monotonic() - self._asked_s > DESERTED_S:
            self._topics.clear()
            changed = True
        if changed:
            self._update_demand()

    def _receive(self, message: Any) -> bool:
        """Read one message from the socket; return whether a subscriber came or went."""
        said = message.bytes
        kind, topic = said[:1], said[1:]
        if kind == b"\x01":
            self._asked_s = time.monotonic()
            if len(self._topics) < MOST_TOPICS:
                self._topics.add(topic)
            return True
        if kind == b"\x00" and sender_of(message) is None and len(self._topics) < MOST_TOPICS:
            self._topics.discard(topic)
            return True
        return False

    def _update_demand(self) -> None:
        """Derive the loop's flags from the topics."""
        topics = self._topics
        plain = len(topics) >= MOST_TOPICS or any(
            topic == b"" or (topic[:1] == FIRST_BYTE and topic not in DECLARING) for topic in topics
        )
        frames = plain or any(topic in DECLARING for topic in topics)
        alone = any(topic[:1] == TOUCH_FIRST_BYTE for topic in topics)
        self.asked = Demand(frames, alone or TOUCHES in topics, alone)
        self.verified = any(map(asked_for, topics))
        self.wanted = frames or alone or self.verified
        self.takes_short = UNCHANGED in topics and ALWAYS not in topics and not plain
        self.streams.set_topics(topics)
        self.joined = True

    @property
    def topics(self) -> frozenset[bytes]:
        """The topics with subscribers at the last ``update``."""
        return frozenset(self._topics)

    @property
    def refused(self) -> int:
        """Number of connections that were closed because there were too many."""
        return self._listener.refused

    @property
    def short(self) -> bool:
        """Whether every subscriber accepts a message without an unchanged map."""
        return self.takes_short and not self.joined

    def send(self, message: memoryview) -> None:
        """Queue one frame message for every subscriber; the memory may be reused at once."""
        try:
            self._send(message, _NOBLOCK, True)
        except zmq.Again:
            self.dropped += 1
        self.joined = False

    def send_beside(self, message: bytes) -> None:
        """Queue one message that is not a frame."""
        try:
            self._send(message, _NOBLOCK, True)
        except zmq.Again:
            self.dropped += 1

    def _end(self) -> None:
        self._context.term()
        if self._authenticator is not None:
            self._authenticator.join()

    def close(self) -> None:
        """Release the address; a second call does nothing."""
        if not self._context.closed:
            self._listener.close()
            self._end()
