"""``for found in eitskin.subscribe_verified(): ...``: verdicts of the verifier, each with its frame.

A frame arrives first and waits here for the verdict with its ``sequence``. An item has a verdict, or says why there is
none: the verifier is not ready, or ended. Such an item comes at each change and every second, so that silence is not
mistaken for agreement.
"""

from collections import OrderedDict
from typing import Final

from eitskin.messaging.curve_keys import ClientKeys
from eitskin.messaging.frame import FIRST_BYTE as FRAME_BYTE
from eitskin.messaging.frame import Frame, unpack_frame
from eitskin.messaging.regions import ALWAYS, WHOLE
from eitskin.messaging.streams.verified import FIRST_BYTE, TOPIC, VerifiedFrame, unpack_verified
from eitskin.messaging.subscriber import Subscriber

QUEUE: Final = 2000
"""Messages that wait on this side."""

MAX_WAITING_FRAMES: Final = 512
"""Frames that wait for their verdict: 2.5 s at 200 frames/s, 3 MB."""

START: Final = "start it as 'eitskin run --verify always'"
"""Advice if no verifier runs."""


class VerifiedSubscription(Subscriber[VerifiedFrame]):
    """An open subscription to verified frames: iterate it, and close it with ``close`` or as a context manager.

    Start the runtime with ``eitskin run --verify always`` or ``idle``.

    Args:
        endpoint: Where the runtime publishes, ``ipc:///path`` or ``tcp://address:port``; None for the default of
            ``eitskin run``.
        mode: ``latest`` returns the newest verdict, for a control loop; ``all`` returns every one, for a recorder.
        frames: Whether verdicts have their ``frame`` with its map; False gives verdicts alone, a tenth of the bytes.
        timeout_s: How long to wait for a message before :class:`eitskin.NoFrame`; while frames come, so does at least
            one message a second. None waits 5 s for the first message and without limit for the next ones;
            ``math.inf`` waits without limit from the start.
        keys: CURVE keys, required for TCP.

    Raises:
        ValueError: The time is not positive, or the mode does not exist.
        EndpointError: The endpoint is malformed, needs keys because it is TCP, or has no folder (the default one).
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
        self.lost = 0
        """Messages that were sent but did not come, because this side was too slow."""
        self._frames: OrderedDict[tuple[str, int], Frame] = OrderedDict()
        self._seen = ("", 0)
        topics = [WHOLE, ALWAYS, FRAME_BYTE, TOPIC] if frames else [TOPIC]
        super().__init__(
            endpoint, topics, QUEUE, mode=mode, timeout_s=timeout_s, keys=keys, nothing="no verified frame"
        )

    def next_verified(self, timeout_s: float | None = None) -> VerifiedFrame:
        """Wait for the next verdict, or message on the verifier's state, and return it.

        Args:
            timeout_s: How long to wait this time; None for the subscription's own timeout.

        Raises:
            NoFrame: No message came in time; the text says whether a runtime is there, and what to do.
            Closed: The subscription was stopped or closed.
        """
        return self._next(timeout_s)

    def _why(self, waited_s: float) -> str:
        if self._frames and not self.received:
            return f"frames arrive, but no verifier runs; {START}"
        likely = "" if self.received else f"no verifier runs ({START})"
        return self.silence(waited_s, "verdict", likely)

    def _item(self, message: bytes) -> VerifiedFrame | None:
        if message[:1] == FRAME_BYTE:  # it is kept for its verdict
            frame = unpack_frame(message, self._heard_ns)
            self._frames[frame.run, frame.sequence] = frame
            while len(self._frames) > MAX_WAITING_FRAMES:
                self._frames.popitem(last=False)
            return None
        if message[:1] != FIRST_BYTE:
            return None  # another publisher's topic with the same beginning
        found = unpack_verified(message, self._heard_ns)
        run, number = self._seen
        if found.run == run and found.number > number + 1:
            self.lost += found.number - number - 1
        self._seen = found.run, found.number
        return found.of_frame(self._frames.get((found.run, found.sequence)))

    def _newer(self, before: VerifiedFrame | None, found: VerifiedFrame | None) -> VerifiedFrame | None:
        """A verdict is worth more than how the verifier is, which comes again."""
        if found is None or (before is not None and before.verified and not found.verified):
            return before
        return found


subscribe_verified = VerifiedSubscription
"""Opens a subscription to the verifier's verdicts on a runtime's frames, to be iterated."""
