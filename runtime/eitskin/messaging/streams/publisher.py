"""The publisher's side of streams: which are subscribed to, the number of each message, and the sources of the bodies.

A stream without subscribers packs nothing; the check for subscribers is one attribute.
"""

from collections.abc import Callable, Collection
from typing import Protocol

from eitskin.messaging.streams.envelope import CLOUD, CONDITIONS, FIRST_BYTE, NAMES, STATE, WIRE, asked_for, packed


class StreamPublisher:
    """Sends the messages of streams.

    Args:
        send: Takes one message for its subscribers.
    """

    __slots__ = ("_send", "asked", "cloud", "conditions", "joined", "numbers", "run", "state", "wire")

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._send = send
        self.numbers = dict.fromkeys(NAMES, 0)
        """Bodies of each stream so far."""
        self.run = ""
        """Differs after each start of the runtime; the source of the bodies sets it."""
        self.asked = self.wire = self.cloud = self.conditions = self.state = False
        """Whether any stream has a subscriber, and each."""
        self.joined = False
        """A subscriber came since this was last set to False: send again what is otherwise sent on changes."""

    def set_topics(self, topics: Collection[bytes]) -> None:
        """Update the subscribed streams."""
        streams = [topic for topic in topics if topic[:1] == FIRST_BYTE]
        if not streams and not self.asked:
            return
        for name in (WIRE, CLOUD, CONDITIONS, STATE):
            setattr(self, name, any(asked_for(name, topic) for topic in streams))
        self.asked = self.wire or self.cloud or self.conditions or self.state
        self.joined = self.asked

    def send(self, name: str, body: bytes) -> None:
        """Send one body of a stream: a MessagePack map."""
        self.numbers[name] = number = self.numbers[name] + 1
        for message in packed(name, number, self.run, body):
            self._send(message)


class StreamFeed(Protocol):
    """Makes the bodies of streams, and hands them to a publisher."""

    @property
    def asked(self) -> bool:
        """Whether any stream has a subscriber."""

    def begin(self, streams: StreamPublisher, run: str) -> None:
        """Send to this publisher from now on, in a run of this id."""

    def frame(self, payload: bytes, number: int | None) -> None:
        """Send the frame in hand, which is computed, and published with this number, if with any."""

    def withheld(self, payload: bytes, read_ns: int) -> None:
        """Send a frame that was withheld just now."""
