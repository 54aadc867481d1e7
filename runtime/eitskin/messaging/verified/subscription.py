"""``for found in eitskin.subscribe_verified(): ...``: what physics says of frames, each with the frame that it is of.

The fast frame comes first and waits here for its verdict, which has its ``sequence``. What is yielded has a verdict, or
says why there is none: the verifier is not ready, or ended. Such a message comes at each change and every second, so
that nobody takes silence for agreement.
"""

import math
import time
from collections import OrderedDict
from typing import Final, Self

import zmq

from eitskin.errors import FrameError, NoFrame
from eitskin.messaging.curve_keys import ClientKeys
from eitskin.messaging.endpoints import default_publish
from eitskin.messaging.frame import FIRST_BYTE as FRAME_BYTE
from eitskin.messaging.frame import Frame, unpack_frame
from eitskin.messaging.received.subscriber import Subscriber
from eitskin.messaging.regions import ALWAYS, WHOLE
from eitskin.messaging.verified.message import FIRST_BYTE, TOPIC, VerifiedFrame, unpack_verified

MODES: Final = ("latest", "all")

QUEUE: Final = 2000
"""Messages that wait on this side."""

REMEMBERED: Final = 512
"""Frames that wait for their verdict: 2.5 s at 200 frames/s, 3 MB."""

FIRST_S: Final = 5.0
"""How long the first message may take where no time was named."""


START: Final = "start it as 'eitskin run --verify always'"
"""What to do where nobody verifies."""


class VerifiedSubscription(Subscriber):
    """An open subscription: iterate it, or call ``next_verified``; leave it with ``close`` or as a context manager.

    Args:
        endpoint: Where the runtime publishes; None takes the one of ``eitskin run``.
        mode: ``latest`` or ``all``.
        frames: Whether each comes with its frame.
        timeout_s: How long to wait; None waits 5 s for the first and then for ever; ``math.inf`` waits for ever.
        keys: CURVE keys, which TCP needs.

    Raises:
        ValueError: The time is not positive, or the mode does not exist.
        EndpointError: ZeroMQ cannot make sense of the endpoint, or there is no folder for the default one.
    """

    def __init__(
        self,
        endpoint: str | None = None,
        mode: str = "latest",
        *,
        frames: bool = True,
        timeout_s: float | None = None,
        keys: ClientKeys | None = None,
    ) -> None:
        if mode not in MODES:
            raise ValueError(f"mode {mode!r} does not exist; expected one of {', '.join(MODES)}")
        if timeout_s is not None and not timeout_s > 0:
            raise ValueError(f"timeout_s is {timeout_s}, expected more than 0")
        self._newest_only = mode == "latest"
        self._timeout_s = math.inf if timeout_s is None else timeout_s
        self._first_s = FIRST_S if timeout_s is None else timeout_s
        self.received = 0
        """Messages taken so far."""
        self.lost = 0
        """Messages that were sent but did not come, because this side was too slow."""
        self._frames: OrderedDict[tuple[str, int], Frame] = OrderedDict()
        self._seen = ("", 0)
        super().__init__(
            default_publish() if endpoint is None else endpoint,
            [WHOLE, ALWAYS, FRAME_BYTE, TOPIC] if frames else [TOPIC],
            QUEUE,
            keys=keys,
        )

    def next_verified(self, timeout_s: float | None = None) -> VerifiedFrame:
        """Return the next verdict, or how the verifier is, waiting for it.

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
                raise NoFrame(f"no verified frame from {self.endpoint} within {timeout_s:g} s: {self._why(timeout_s)}")
            found = self._take(self._recv())
            while self._newest_only and self._socket.getsockopt(zmq.EVENTS) & zmq.POLLIN:
                found = _newer(found, self._take(self._recv()))
            if found is not None:
                return found
            if time.perf_counter() >= end_s:
                raise NoFrame(f"no verified frame from {self.endpoint} within {timeout_s:g} s: {self._why(timeout_s)}")

    def _why(self, timeout_s: float) -> str:
        if self._frames and not self.received:
            return f"frames come, but nobody verifies them; {START}"
        likely = "" if self.received else f"nobody verifies its frames ({START})"
        return self.silence(timeout_s, "verdict", likely)

    def _take(self, message: bytes) -> VerifiedFrame | None:
        """Return what a message says of a frame; None for a frame, which is kept for its verdict."""
        now_ns = self._heard_ns
        try:
            if message[:1] == FIRST_BYTE:
                return self._matched(unpack_verified(message, now_ns))
            if message[:1] != FRAME_BYTE:
                return None  # a topic of somebody else's that begins alike
            frame = unpack_frame(message, now_ns)
        except FrameError as error:
            self._reject(error)
            return None
        self._frames[frame.run, frame.sequence] = frame
        while len(self._frames) > REMEMBERED:
            self._frames.popitem(last=False)
        return None

    def _matched(self, found: VerifiedFrame) -> VerifiedFrame:
        run, number = self._seen
        if found.run == run and found.number > number + 1:
            self.lost += found.number - number - 1
        self._seen = found.run, found.number
        self.received += 1
        self._unusable = 0, ""
        return found.of_frame(self._frames.get((found.run, found.sequence)))

    __next__ = next_verified

    def __iter__(self) -> Self:
        return self


def _newer(before: VerifiedFrame | None, found: VerifiedFrame | None) -> VerifiedFrame | None:
    """Return the newer of two; but a verdict is worth more than how the verifier is, which comes again."""
    if found is None or (before is not None and before.verified and not found.verified):
        return before
    return found


def subscribe_verified(
    endpoint: str | None = None,
    mode: str = "latest",
    *,
    frames: bool = True,
    timeout_s: float | None = None,
    keys: ClientKeys | None = None,
) -> VerifiedSubscription:
    """Return an open subscription to what physics says of a runtime's frames, to be iterated.

    The runtime verifies frames where it was started with ``eitskin run --verify always`` or ``idle``.

    Args:
        endpoint: Where the runtime publishes: ``ipc:///path`` or ``tcp://address:port``; None takes the one on which
            ``eitskin run`` publishes unless told otherwise.
        mode: ``latest`` for a control loop, ``all`` for a recorder.
        frames: Whether each has its ``frame``, map included; False for verdicts alone, a tenth of the bytes.
        timeout_s: How long to wait for a message before :class:`eitskin.NoFrame`; one comes every second at least,
            while frames come. None waits 5 s for the first, and then for ever; ``math.inf`` waits for ever from the
            start.
        keys: CURVE keys, which TCP needs.

    Raises:
        ValueError: The time is not positive, or the mode does not exist.
        EndpointError: ZeroMQ cannot make sense of the endpoint, or there is no folder for the default one.
    """
    return VerifiedSubscription(endpoint, mode, frames=frames, timeout_s=timeout_s, keys=keys)
