"""Floods: connections and messages as fast as one process can make them."""

import random
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress

from .peer import GREETING, MORE, Peer, attempt, packed, ready

HELD = 400
"""Connections of a flood that are held at a time."""

PACED = 100
"""Subscriptions at once up to which a flood waits in between, so that nothing of it ever waits to be read."""

TURN_S = 0.02
"""What is waited for who holds his queue full."""


def connect(endpoint: str, span_s: float, rng: random.Random, held: int = HELD, patience: int = 0) -> int:
    """Connect again and again, say nothing, a little or the whole handshake, and leave; return how often.

    Args:
        endpoint: Where.
        span_s: For how long.
        rng: Draws what is said.
        held: Connections that are held at once.
        patience: After how many connections to end; 0 for all of the time.
    """
    openings = (b"", GREETING[:10], GREETING, GREETING + ready("SUB"), GREETING + ready("SUB") + packed(b"\x01x"))
    held_ones: deque[socket.socket] = deque()
    made, end_s = 0, time.monotonic() + span_s
    while time.monotonic() < end_s and not (patience and made >= patience):
        stream = attempt(endpoint)
        if stream is None:
            time.sleep(TURN_S)
        else:
            made += 1
            held_ones.append(stream)
            with suppress(OSError):
                stream.send(rng.choice(openings))
        while len(held_ones) > (held if stream is not None else held // 2):
            held_ones.popleft().close()
    for stream in held_ones:
        stream.close()
    return made


def ask(endpoint: str, span_s: float, flags: int = 0, peers: int = 4, at_once: int = 2000) -> int:
    """Send distinct subscriptions as fast as they are taken, from new connections when ended; return how many bytes.

    Args:
        endpoint: Where.
        span_s: For how long.
        flags: Of each frame: ``MORE`` makes one message of all of them that never ends.
        peers: Connections at a time.
        at_once: Subscriptions that are sent at once; who sends few, and waits, never fills its line.
    """
    text = b"".join(packed(b"\x01" + index.to_bytes(6, "little") + bytes(40), flags) for index in range(at_once))
    taken, end_s = 0, time.monotonic() + span_s
    streams: list[socket.socket] = []
    while time.monotonic() < end_s:
        while len(streams) < peers:
            try:
                stream = Peer(endpoint, patience_s=max(0.1, end_s - time.monotonic())).stream
            except OSError:
                break
            stream.setblocking(False)
            streams.append(stream)
        _, able, _ = select.select([], streams, [], 0.02)
        for stream in able:
            try:
                taken += stream.send(text)
                time.sleep(0.0 if at_once > PACED else 1e-4)
            except BlockingIOError:
                continue
            except OSError:
                stream.close()
                streams.remove(stream)
    for stream in streams:
        stream.close()
    return taken


@contextmanager
def meanwhile(work: Callable[[], object]) -> Iterator[None]:
    """Do something in a thread beside the body, and wait for its end; what it raises is raised."""
    failed: list[BaseException] = []

    def guarded() -> None:
        try:
            work()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=guarded)
    thread.start()
    try:
        yield
    finally:
        thread.join()
    if failed:
        raise failed[0]


def side_by_side(works: Sequence[Callable[[], object]]) -> None:
    """Do several things at once, each in a thread; what one of them raises is raised."""
    with ExitStack() as stack:
        for work in works:
            stack.enter_context(meanwhile(work))


__all__ = ["HELD", "MORE", "ask", "connect", "meanwhile", "side_by_side"]
