"""``for item in eitskin.subscribe_streams(): ...``: all measurements as they come, none skipped on purpose.

Distinguish the items by their class: :class:`~.measured.WireFrame`, :class:`~.measured.CloudInUse`,
:class:`~.measured.Conditions`, :class:`~.state.SkinState`. A slow subscriber loses messages at the runtime; ``lost``
counts them for each stream.
"""

from dataclasses import replace
from typing import Final

from eitskin.messaging.curve_keys import ClientKeys
from eitskin.messaging.streams.envelope import (
    CLOUD,
    CONDITIONS,
    FIRST_BYTE,
    NAMES,
    STATE,
    TOPICS,
    WIRE,
    BodyJoiner,
    opened,
)
from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
from eitskin.messaging.streams.state import SkinState
from eitskin.messaging.subscriber import Subscriber

QUEUE: Final = 4000
"""Messages that wait on this side: 20 s of the wire at 200 frames/s."""

Item = WireFrame | CloudInUse | Conditions | SkinState
"""The items of a subscription."""

CLASSES: Final[dict[str, type[Item]]] = {WIRE: WireFrame, CLOUD: CloudInUse, CONDITIONS: Conditions, STATE: SkinState}
"""By their streams."""


class StreamSubscription(Subscriber[Item]):
    """An open subscription to a runtime's measurements: iterate it, and close it with ``close`` or a ``with`` block.

    Args:
        endpoint: Where the runtime publishes, ``ipc:///path`` or ``tcp://address:port``; None for the default of
            ``eitskin run``.
        wire: Request each frame from the wire, :class:`eitskin.WireFrame`.
        clouds: Request the cloud in use, :class:`eitskin.CloudInUse`.
        state: Request device, runtime and status, :class:`eitskin.SkinState`.
        conditions: Request :class:`eitskin.Conditions`; None requests them if ``wire`` is requested.
        timeout_s: How long to wait for a message before :class:`eitskin.NoFrame`. None waits 5 s for the first message
            and without limit for the next ones; ``math.inf`` waits without limit from the start.
        keys: CURVE keys, required for TCP.

    Raises:
        ValueError: No stream is requested, or the time is not positive.
        EndpointError: The endpoint is malformed, needs keys because it is TCP, or has no folder (the default one).
    """

    def __init__(
        self,
        endpoint: str | None = None,
        *,
        wire: bool = True,
        clouds: bool = True,
        state: bool = True,
        conditions: bool | None = None,
        timeout_s: float | None = None,
        keys: ClientKeys | None = None,
    ) -> None:
        asked = {WIRE: wire, CLOUD: clouds, STATE: state, CONDITIONS: wire if conditions is None else conditions}
        if not any(asked.values()):
            raise ValueError("found no stream, expected at least one of wire, clouds, state, conditions")
        self.lost = dict.fromkeys(NAMES, 0)
        """Messages of each stream that did not come, because this side was too slow."""
        self._joiner = BodyJoiner()
        self._numbers: dict[str, tuple[str, int]] = {}
        self._reference: tuple[str, bytes | None] = ("", None)
        # All by one topic: of several libzmq sends the wire's first, whose frames would come before the others.
        every = all(asked.values())
        topics = [FIRST_BYTE] if every else [TOPICS[name] for name, is_asked in asked.items() if is_asked]
        super().__init__(endpoint, topics, QUEUE, timeout_s=timeout_s, keys=keys, nothing="nothing of a stream")

    def next_item(self, timeout_s: float | None = None) -> Item:
        """Wait for the next item and return it.

        Args:
            timeout_s: How long to wait this time; None for the subscription's own timeout.

        Raises:
            NoFrame: No message came in time; the text says whether a runtime is there, and what to do.
            Closed: The subscription was stopped or closed.
        """
        return self._next(timeout_s)

    def _item(self, message: bytes) -> Item | None:
        found = opened(message)
        if found.part == 0:
            run, number = self._numbers.get(found.name, ("", 0))
            if run == found.run and found.number > number + 1:
                self.lost[found.name] += found.number - number - 1
            self._numbers[found.name] = found.run, found.number
        body = self._joiner.add(found)
        if body is None:
            return None
        item = replace(CLASSES[found.name].of(body), n=found.number, run=found.run, received_ns=self._heard_ns)
        if isinstance(item, SkinState):
            if item.reference is not None:
                self._reference = item.reference_sha256, item.reference
            elif self._reference[0] == item.reference_sha256:
                item = replace(item, reference=self._reference[1])
        return item


subscribe_streams = StreamSubscription
"""Opens a subscription to a runtime's measurements, to be iterated."""
