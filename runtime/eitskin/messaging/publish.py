r"""Publishes frames: one part a message, to whoever subscribed, waiting for nobody.

The socket is an XPUB: it tells who subscribes, so that a frame nobody wants costs no inference. Every subscriber has a
bounded queue; a slow one loses frames there, and neither the loop nor its neighbours notice.

Topics say what a subscriber needs. Who takes the first two bytes of a frame gets every frame with its whole map; so
does the empty topic, with all that others ask for besides. A subscriber that takes the first byte alone declares by
topics of its own whether it does without a map that has not changed (:mod:`eitskin.messaging.regions`). So does a
patient one, which takes three bytes: libzmq hands a message to the shortest topic first, so robots, whose topics are
shorter, do not wait for it. ::

    b"\xde\x00"                    every frame with its map, always
    b""                            all that is sent
    b"\xde"                        every frame, and then one of each:
    b"\xde\x00\x18"                ... likewise, after the others; and so on to b"\xde\x00\x23"
    b"eitskin/region/..."          nothing: earlier releases computed only a part of the map
    b"eitskin/unchanged"           ... or b"eitskin/always"
    b"eitskin/touches"             besides: the list of touches, in every frame
    b"\xdf"                        touches without maps, alone
    b"\x86\xa4wire"                what was measured (:mod:`eitskin.messaging.streams.envelope` has the list)
    b"\x8f\xa8verified"            what physics says of frames (:mod:`eitskin.messaging.verified.message`)

Those with the empty topic get touch messages and streams too, and leave them alone for their version. Touch messages
are sent first, so that who keeps one message keeps the frame; streams go behind the frame, unless there is such a one.

Subscribers are not trusted. All that they can send is subscriptions, which libzmq keeps in memory for them: messages
are limited to a few bytes, few of them wait, and who sends more than any honest subscriber would is ended, as is who
comes when there are enough (:mod:`eitskin.messaging.admission`). Nobody else notices.
"""

from typing import Any, Final

import zmq

from eitskin.messaging.admission.descriptors import end
from eitskin.messaging.admission.door import Door
from eitskin.messaging.admission.patrol import Patrol
from eitskin.messaging.admission.topics import Topics
from eitskin.messaging.admission.turnstile import Turnstile
from eitskin.messaging.curve_keys import Doorkeeper, ServerKeys
from eitskin.messaging.frame import FIRST_BYTE, TOUCH_FIRST_BYTE, patient_topics
from eitskin.messaging.frame_message import Asked
from eitskin.messaging.regions import ALWAYS, TOUCHES, UNCHANGED
from eitskin.messaging.streams.desk import StreamDesk
from eitskin.messaging.verified.message import asked_for
from eitskin_proto.skin.skin import PAPER

QUEUE_FRAMES: Final = 400
"""Frames that may wait for one subscriber, and none is lost: 2 s at 200 frames/s."""

MOST_WAITING: Final = 2 * QUEUE_FRAMES
"""What libzmq is told, 4.8 MB. It hears of what a subscriber took only at every half of it, and takes the rest to be
waiting still: for who is just short of a half, half the room is there (libzmq 4.3.5)."""

LARGEST_SUBSCRIPTION: Final = 512
"""Bytes; a subscription to everything has 1, but CURVE's handshake, which counts as well, has up to 260."""

QUEUE_SUBSCRIPTIONS: Final = 2
"""Subscription messages of one connection that wait within libzmq. It reads until none waits: with more, a flood keeps
it reading within one call for a quarter of a second. With 1, CURVE's handshake does not end (libzmq 4.3.5)."""

MOST_AT_ONCE: Final = 1024
"""Subscription messages that are taken in one look; a crowd of 128 that comes at once has 400. A connection that is
ended in a flood leaves some hundred, so this is what a flood leaves in one look, several times."""

CALM: Final = 64
"""Subscription messages of a look that lets newcomers in: those before them have been taken in. Twenty honest ones that
come at once have as many."""

_EVENTS, _POLLIN, _NOBLOCK = zmq.EVENTS, int(zmq.POLLIN), int(zmq.NOBLOCK)  # an enumeration's & takes microseconds

MOST_SUBSCRIBERS: Final = 128
"""At once; whoever comes then is ended."""

DECLARING: Final = frozenset((FIRST_BYTE, *patient_topics(FIRST_BYTE)))
"""Topics of frames for subscribers that say by topics of their own what they need of them."""


class Publisher:
    """A bound publishing socket; release it with ``close``.

    Args:
        endpoint: ``ipc:///path`` or ``tcp://address:port``.
        keys: CURVE keys, needed for TCP beyond loopback.
        shape: Rows and columns of the maps that are published.

    Raises:
        EndpointError: The endpoint is not allowed like this, or in use.
    """

    def __init__(
        self, endpoint: str, keys: ServerKeys | None = None, shape: tuple[int, int] = PAPER.grid.shape
    ) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._keys = keys
        self.dropped = 0
        """Frames that the socket did not take."""
        self._doorkeeper = Doorkeeper(self._context, keys) if keys is not None else None
        self._turnstile = Turnstile(self._context) if keys is None and endpoint.startswith("tcp:") else None
        self.wanted = False
        """Whether anybody subscribes, as of the last ``look``."""
        self.asked = Asked()
        """What else is asked for."""
        self.verified = False
        """Whether anybody asks for what physics says of frames."""
        self.takes_short = False
        """Whether every subscriber does without a map that has not changed."""
        self.joined = True
        """Somebody came or went since the last frame was sent: the next one must carry its map."""
        self.streams = StreamDesk(self.send_beside)
        """Where messages of what was measured are handed in."""
        self._talkative = self._greedy = 0
        try:
            self._open(endpoint)
        except BaseException:
            self._end()
            raise

    def _open(self, endpoint: str) -> None:
        self._socket: Any = self._context.socket(zmq.XPUB)
        self._send = super(zmq.Socket, self._socket).send  # without the wrapper, which is for other kinds of sockets
        self._socket.setsockopt(zmq.SNDHWM, MOST_WAITING)
        self._socket.setsockopt(zmq.RCVHWM, QUEUE_SUBSCRIPTIONS)
        self._socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_SUBSCRIPTION)
        self._socket.setsockopt(zmq.HANDSHAKE_IVL, 2000)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.XPUB_VERBOSER, 1)  # every subscriber by itself, not the first and the last of many
        if self._turnstile is not None:
            self._turnstile.apply(self._socket)
        self._door = Door(self._socket, endpoint, keys=self._keys, control=False, most=MOST_SUBSCRIBERS)
        self._topics = Topics(self._door.connection_at)
        self._patrol = Patrol(self._look_meanwhile)
        if self._door.open_to_all:
            self._patrol.start()
        self.endpoint = self._door.endpoint
        """Where frames are published, with the port that a ``*`` became."""

    def look(self) -> None:
        """Take note of who came and went since the last time; never waits."""
        with self._patrol.lock:
            self._patrol.seen = True
            self._look()

    def _look(self) -> None:
        topics, left = self._topics, MOST_AT_ONCE
        topics.begin()
        self._greedy = self._door.end_greedy()
        waits = self._socket.getsockopt(_EVENTS) & _POLLIN  # libzmq takes in more whenever it is asked
        while waits and left:
            try:
                topics.take(self._socket.recv(_NOBLOCK, copy=False))
            except zmq.Again:
                break
            left -= 1
        for connection in filter(self._door.sent_much, topics.talkative):
            end(connection)
            self._talkative += 1
        if topics.changed:
            self._judge()
        calm = left >= MOST_AT_ONCE - CALM
        if calm and self._turnstile is not None:
            self._turnstile.calm()
        self._door.look(topics.of, newcomers=calm)

    def _judge(self) -> None:
        """Make of the topics what the loop must know."""
        self._topics.changed = False
        topics = self.topics
        plain = any(topic == b"" or (topic[:1] == FIRST_BYTE and topic not in DECLARING) for topic in topics)
        frames = plain or any(topic in DECLARING for topic in topics)
        alone = any(topic[:1] == TOUCH_FIRST_BYTE for topic in topics)
        self.asked = Asked(frames, alone or TOUCHES in topics, alone)
        self.verified = any(map(asked_for, topics))
        self.wanted = frames or alone or self.verified
        self.takes_short = UNCHANGED in topics and ALWAYS not in topics and not plain
        self.streams.judge(topics)
        self.joined = True

    @property
    def topics(self) -> dict[bytes, int]:
        """What is subscribed to, and by how many, as of the last ``look``."""
        return self._topics.all()

    @property
    def ended(self) -> int:
        """Connections that were ended because they asked for more than anybody honest would."""
        return self._talkative + self._greedy

    @property
    def refused(self) -> int:
        """Connections that were ended because there were too many."""
        return self._door.ended

    def look_at_connections(self) -> None:
        """End who is too many; cheap enough for a few times a second, not for each frame."""
        with self._patrol.lock:
            self._topics.sweep()
            self._door.count(self._topics.of)

    def _look_meanwhile(self) -> None:
        """End who is too many, or sends without end, while nobody looks for subscriptions."""
        self._door.end_endless()
        self._door.count(self._topics.of)

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

    def send_beside(self, message: bytes) -> None:
        """Hand on one message that is no frame."""
        try:
            self._send(message, _NOBLOCK, True)
        except zmq.Again:
            self.dropped += 1

    def _end(self) -> None:
        self._socket.close(0)
        self._context.term()
        for guard in (self._doorkeeper, self._turnstile):
            if guard is not None:
                guard.join()

    def close(self) -> None:
        """Release the address; closing twice is fine."""
        if self._context.closed:
            return
        self._patrol.close()
        self._door.close()
        self._end()
