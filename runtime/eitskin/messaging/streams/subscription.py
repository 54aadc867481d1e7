"""``for item in eitskin.subscribe_streams(): ...``: what was measured, as it comes, none skipped on purpose.

What is yielded is told apart by its class: :class:`~.measured.WireFrame`, :class:`~.measured.CloudInUse`,
:class:`~.measured.Conditions`, :class:`~.state.SkinState`. Whoever is too slow loses messages at the runtime, and sees
it: ``lost`` counts them, stream by stream, by their numbers.
"""

import math
import time
from dataclasses import replace
from typing import Any, Final, Self

from eitskin.errors import FrameError, NoFrame
from eitskin.messaging.curve_keys import ClientKeys
from eitskin.messaging.endpoints import default_publish
from eitskin.messaging.received.subscriber import Subscriber
from eitskin.messaging.streams.envelope import CLOUD, CONDITIONS, FIRST_BYTE, NAMES, STATE, TOPICS, WIRE, Joiner, opened
from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
from eitskin.messaging.streams.state import SkinState

QUEUE: Final = 4000
"""Messages that wait on this side: 20 s of the wire at 200 frames/s."""

FIRST_S: Final = 5.0
"""How long the first message may take where no time was named."""

Item = WireFrame | CloudInUse | Conditions | SkinState
"""What a subscription yields."""


class StreamSubscription(Subscriber):
    """An open subscription: iterate it, or call ``next_item``; leave it with ``close`` or as a context manager.

    Args:
        endpoint: Where the runtime publishes; None takes the one of ``eitskin run``.
        wire: Each frame of the wire.
        clouds: The cloud in use.
        state: Who measures, by what, and how it goes.
        conditions: What else decides a frame's map; None: with ``wire``.
        timeout_s: How long to wait for the next message; None waits 5 s for the first and then for ever; ``math.inf``
            waits for ever from the start.
        keys: CURVE keys, which TCP needs.

    Raises:
        ValueError: Nothing is asked for, or the time is not positive.
        EndpointError: ZeroMQ cannot make sense of the endpoint, or there is no folder for the default one.
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
            raise ValueError("no stream is asked for; expected at least one of wire, clouds, state, conditions")
        if timeout_s is not None and not timeout_s > 0:
            raise ValueError(f"timeout_s is {timeout_s}, expected more than 0")
        self._timeout_s = math.inf if timeout_s is None else timeout_s
        self._first_s = FIRST_S if timeout_s is None else timeout_s
        self.received = 0
        """Items taken so far."""
        self.lost = dict.fromkeys(NAMES, 0)
        """Messages of each stream that did not come, because this side was too slow."""
        self._joiner = Joiner()
        self._numbers: dict[str, tuple[str, int]] = {}
        self._reference: tuple[str, bytes | None] = ("", None)
        super().__init__(
            default_publish() if endpoint is None else endpoint,
            # All by one topic: of several libzmq sends the wire's first, whose frames would come before the others.
            [FIRST_BYTE] if all(asked.values()) else [TOPICS[name] for name, is_asked in asked.items() if is_asked],
            QUEUE,
            keys=keys,
        )

    def next_item(self, timeout_s: float | None = None) -> Item:
        """Return the next item, waiting for it.

        Args:
            timeout_s: How long, this time; None as the subscription was told.

        Raises:
            NoFrame: None came in time; the text says whether anybody is there, and what to do.
        """
        if timeout_s is None:
            timeout_s = self._timeout_s if self.received else self._first_s
        end_s = time.perf_counter() + timeout_s
        while True:
            if not self._comes(end_s):
                why = self.silence(timeout_s)
                raise NoFrame(f"nothing of a stream from {self.endpoint} within {timeout_s:g} s: {why}")
            try:
                item = self._take(self._recv(), self._heard_ns)
            except FrameError as error:
                self._reject(error)
                continue
            if item is not None:
                self.received += 1
                self._unusable = 0, ""
                return item

    def _take(self, message: bytes, received_ns: int) -> Item | None:
        """Return what a message holds; None if it is a part of something that is not whole yet."""
        found = opened(message)
        if found.part == 0:
            run, number = self._numbers.get(found.name, ("", 0))
            if run == found.run and found.number > number + 1:
                self.lost[found.name] += found.number - number - 1
            self._numbers[found.name] = found.run, found.number
        body = self._joiner.take(found)
        if body is None:
            return None
        origin: Any = {"n": found.number, "run": found.run, "received_ns": received_ns}
        if found.name == WIRE:
            return WireFrame.of(body, **origin)
        if found.name == CLOUD:
            return CloudInUse.of(body, **origin)
        if found.name == CONDITIONS:
            return Conditions.of(body, **origin)
        state = SkinState.of(body, **origin)
        if state.reference is not None:
            self._reference = state.reference_sha256, state.reference
        elif self._reference[0] == state.reference_sha256:
            state = replace(state, reference=self._reference[1])
        return state

    __next__ = next_item

    def __iter__(self) -> Self:
        return self


def subscribe_streams(
    endpoint: str | None = None,
    *,
    wire: bool = True,
    clouds: bool = True,
    state: bool = True,
    conditions: bool | None = None,
    timeout_s: float | None = None,
    keys: ClientKeys | None = None,
) -> StreamSubscription:
    """Return an open subscription to what a runtime measures, to be iterated.

    Args:
        endpoint: Where the runtime publishes: ``ipc:///path`` or ``tcp://address:port``; None takes the one on which
            ``eitskin run`` publishes unless told otherwise.
        wire: Each frame as it came over the wire: :class:`eitskin.WireFrame`.
        clouds: The cloud in use: :class:`eitskin.CloudInUse`.
        state: Who measures, by what, and how it goes: :class:`eitskin.SkinState`.
        conditions: What else decides a frame's map: :class:`eitskin.Conditions`; None: with ``wire``.
        timeout_s: How long to wait for the next message before :class:`eitskin.NoFrame`. None waits 5 s for the first
            and then for ever; ``math.inf`` waits for ever from the start.
        keys: CURVE keys, which TCP needs.

    Raises:
        ValueError: Nothing is asked for, or the time is not positive.
        EndpointError: ZeroMQ cannot make sense of the endpoint, or there is no folder for the default one.
    """
    return StreamSubscription(
        endpoint, wire=wire, clouds=clouds, state=state, conditions=conditions, timeout_s=timeout_s, keys=keys
    )
