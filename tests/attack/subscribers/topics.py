"""Attacks by what is subscribed to: topics of others taken back, more topics than fit anywhere."""

import random
import time
from contextlib import closing

from ..outcome import Effort, Outcome
from ..stream import Stream
from ..zmtp import flood
from ..zmtp.peer import Peer
from .ground import defended, memory_mib, status

MODEST = (b"eitskin/region/0/30/0/45", b"eitskin/region/10/20/10/20", b"eitskin/unchanged", b"eitskin/always", b"\xde")

GROWTH_MIB = 48.0
"""What a flood may leave in the runtime's memory."""

TRIES = 3
"""Floods that must all leave more: on a busy machine who floods may be served before who guards, for once."""


def unknown_unsubscriptions(effort: Effort) -> Outcome:
    """Take back what others subscribed to: everything, the first byte of a frame."""
    outcome = Outcome("subscribers.unsubscriptions")
    rng = random.Random(effort.seed)
    for what, arguments in (("ipc", ()), ("TCP", ("--publish", "tcp://127.0.0.1:*"))):
        with defended(outcome, f"{what}: everything was unsubscribed by somebody else", arguments=arguments) as stream:
            for _ in range(effort.count(5, 200)):
                with closing(Peer(stream.frames)) as peer:
                    peer.unsubscribe(b"", *rng.sample(MODEST, 3))
                    peer.subscribe(rng.choice(MODEST))
                    peer.unsubscribe(b"")
            _wait_for_frames(stream, effort.count(100, 1000))
    return outcome


def topic_floods(effort: Effort) -> Outcome:
    """Subscribe without end, to ever new topics; on TCP, where strangers come from, with messages without end too."""
    outcome = Outcome("subscribers.topics")
    span_s = effort.count(2, 20)
    for what, flags, at_once, endpoints in (
        ("topics over ipc", 0, 2000, ()),
        ("topics over TCP", 0, 2000, ("tcp",)),
        ("parts of one message over TCP", flood.MORE, 2000, ("tcp",)),
        ("parts that come one by one", flood.MORE, flood.PACED, ("tcp",)),
    ):
        named = ("--publish", "tcp://127.0.0.1:*") if endpoints else ()
        for _ in range(TRIES):
            with defended(outcome, what, arguments=named) as stream:
                before = memory_mib(stream)
                sent = flood.ask(stream.frames, span_s, flags, at_once=at_once)
                grown = memory_mib(stream) - before
            if grown < GROWTH_MIB:
                break
        outcome.figures[f"{what}, MB/s"] = round(sent / span_s / 1e6, 2)
        outcome.figures[f"{what}, MiB grown"] = round(grown, 1)
        outcome.note(grown < GROWTH_MIB, f"{what}: {sent} bytes left {grown:.0f} MiB in memory, {TRIES} times")
    return outcome


def _wait_for_frames(stream: Stream, number: int) -> None:
    first = status(stream)["frames"]
    while status(stream)["frames"] < first + number:
        time.sleep(0.05)
