"""The publishing loop: a skin's frames to whoever subscribed, until told to stop."""

import time
from typing import Final

from eitskin.publish import Publisher
from eitskin.skin import Skin

LOOK_NS: Final = 200_000_000
"""How often connections are counted."""


def serve(skin: Skin, publisher: Publisher, *, frames: int | None = None, until_ns: int | None = None) -> None:
    """Publish frames until ``skin.stop()``, a number of frames, or a time.

    A frame that nobody subscribed to is read, decoded and judged by the gate, but neither computed nor packed.

    Args:
        skin: Open, with a reference.
        publisher: Bound.
        frames: How many to go through; None for no limit.
        until_ns: When to end, on ``perf_counter_ns``; None for no limit.

    Raises:
        PortLost: The port vanished.
        HandshakeError: The device fell silent and does not answer, or came back as another one.
    """
    next_look_ns = time.perf_counter_ns() + LOOK_NS
    regions = publisher.regions
    publisher.look()
    for _ in skin.readings(lambda: publisher.wanted, until_ns):
        if publisher.wanted:
            publisher.send(skin.pack(short=publisher.takes_short and not publisher.joined))
            publisher.joined = False
        else:
            skin.pass_over()
        skin.finish()
        publisher.look()  # behind the frame, not before it: who comes now is served from the next one on
        if publisher.regions is not regions:
            regions = publisher.regions
            skin.set_regions(regions)
        if frames is not None and skin.statistics.frames >= frames:
            return
        if skin.pipeline.stamps[0] > next_look_ns:
            publisher.look_at_connections()
            next_look_ns = skin.pipeline.stamps[0] + LOOK_NS
