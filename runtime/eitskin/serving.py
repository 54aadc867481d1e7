"""The publishing loop: a skin's frames to whoever subscribed, until told to stop."""

import time
from collections.abc import Callable
from contextlib import closing
from typing import Final

from eitskin.messaging.frame_record import READ, FrameRecord
from eitskin.messaging.publish import Publisher
from eitskin.skin import Skin

JOIN_NS: Final = 10_000_000
"""How often it is asked who subscribes: so long a newcomer waits, at most, for what nobody else wanted."""


def serve(
    skin: Skin,
    publisher: Publisher,
    *,
    frames: int | None = None,
    until_ns: int | None = None,
    behind: Callable[[FrameRecord], None] | None = None,
) -> None:
    """Publish frames until ``skin.stop()``, a number of frames, or a time.

    A frame that nobody subscribed to is read, decoded and judged by the gate, but neither computed nor packed.

    Args:
        skin: Open, with a reference.
        publisher: Bound.
        frames: How many to go through; None for no limit.
        until_ns: When to end, on ``perf_counter_ns``; None for no limit.
        behind: Called with each frame's record when it has gone out; the next frame waits for it.

    Raises:
        PortLost: The port vanished.
        HandshakeError: The device fell silent and does not answer, or came back as another one.
    """
    next_join_ns = time.perf_counter_ns()
    publisher.look()
    with closing(skin.publish(publisher, until_ns)) as records:  # what is left of the last frame is done here, and now
        for record in records:
            if behind is not None:
                behind(record)
            if frames is not None and skin.statistics.frames >= frames:
                return
            now_ns = record.stamps[READ]
            if now_ns >= next_join_ns:  # behind a frame, not before it
                next_join_ns = now_ns + JOIN_NS
                publisher.look()
                if publisher.streams.joined:
                    skin.pipeline.maps.renew()
