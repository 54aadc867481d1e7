"""Who subscribed to what, a connection at a time.

libzmq hands up every unsubscription, also one of a topic that its sender never had; believed, it would take the topic
from somebody else. So topics belong to connections, as they do within libzmq, and go with them.

A message names the descriptor over which it came. Who sent it may have left before it is taken, and a newcomer may lie
there by then: the newcomer is not to pay for it. Its own messages are always the later ones, so the newest topics are
kept; and who asked for too much is ended only if it sent as much (:meth:`~.door.Door.sent_much`).
"""

from collections.abc import Callable
from typing import Any, Final

import zmq

from eitskin.messaging.admission.descriptors import Connection, connection_at

MOST_TOPICS: Final = 16
"""Of one subscriber, which has one or three; of more the newest count."""

MOST_MESSAGES: Final = 64
"""Of one subscriber between two looks."""

SWEEPS: Final = 20
"""Looks at which departed subscribers are looked for after libzmq told of one; it closes the connection later."""


class Topics:
    """The topics of every connection.

    Args:
        at: Gives which of the socket's connections lies at a descriptor now, if any.
    """

    __slots__ = ("_at", "_messages", "_sweeps", "changed", "of", "talkative")

    def __init__(self, at: Callable[[int], Connection | None]) -> None:
        self._at = at
        self.of: dict[Connection, dict[bytes, None]] = {}
        """Of each connection that has any, the newest last."""
        self.changed = True
        """Somebody came, went, or asked for something else since this was last set to False."""
        self.talkative: set[Connection] = set()
        """Who asked for more than any honest subscriber would, or who lies where that one lay, since ``begin``."""
        self._messages: dict[Connection, int] = {}
        self._sweeps = 0

    def begin(self) -> None:
        """Begin a look."""
        if self._messages:
            self._messages.clear()
            self.talkative.clear()
        if self._sweeps:
            self._sweeps -= 1
            self.sweep()

    def take(self, message: Any) -> None:
        """Take one message of an XPUB socket, received as a frame."""
        try:
            descriptor = message.get(zmq.SRCFD)
        except zmq.ZMQError:  # libzmq made it up itself, for a subscriber that left
            self._sweeps = SWEEPS
            return
        sender = self._at(descriptor)
        if sender is None:
            return  # it has left, whatever lies there now
        self._messages[sender] = count = self._messages.get(sender, 0) + 1
        said = message.bytes
        kind, topic = said[:1], said[1:]
        if count > MOST_MESSAGES:
            self.talkative.add(sender)
        if kind == b"\x01":
            self._add(sender, topic)
        elif kind == b"\x00" and topic in (topics := self.of.get(sender, {})):
            del topics[topic]
            if not topics:
                del self.of[sender]
            self.changed = True

    def _add(self, sender: Connection, topic: bytes) -> None:
        topics = self.of.setdefault(sender, {})
        if len(topics) >= MOST_TOPICS and topic not in topics:
            self.talkative.add(sender)
            del topics[next(iter(topics))]
        topics[topic] = None
        self.changed = True

    def sweep(self) -> None:
        """Forget the topics of who has left."""
        for connection in list(self.of):
            if connection_at(connection[0]) != connection:
                del self.of[connection]
                self.changed = True

    def all(self) -> dict[bytes, int]:
        """Return {topic: how many have it}."""
        counts: dict[bytes, int] = {}
        for topics in self.of.values():
            for topic in topics:
                counts[topic] = counts.get(topic, 0) + 1
        return counts
